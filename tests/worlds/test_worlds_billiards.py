"""The billiards simulator against exact solutions and conservation laws, run as a process like everywhere."""

from __future__ import annotations

import ast
import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
RADIUS, GRAVITY = 0.028575, 9.81


SLIDE, ROLL, SPEED = 0.2, 0.01, 0.7
QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
TURNS = [np.linalg.matrix_power(QUARTER, k) for k in range(4)]
RATES = (60, 120, 1020, 1000)


def describe_shot(balls: list[dict[str, Any]], seconds: float, effects: dict[str, Any], **shot: Any) -> dict[str, Any]:
    for i, ball in enumerate(balls):
        ball.update(id=ball.get("id", "abcd"[i]), radius=RADIUS)
    table = {"length": 2.54, "width": 1.27, "pockets": shot.pop("pockets", False)}
    return {"table": table, "seconds": seconds, "hz": 1000, "balls": balls, "effects": effects, **shot}


def turn_shot() -> list[dict[str, Any]]:
    """Four rolling balls, the same shot turned by quarter turns: to the right, bottom, left and top cushion."""
    balls = []
    for turn, (x, y) in zip(TURNS, [(2.3, 0.5), (1.2, 1.03), (0.24, 0.7), (1.5, 0.24)], strict=True):
        vx, vy = turn @ (1.5, 0.4)
        balls.append(
            {"id": f"{x}", "x": x, "y": y, "vx": vx, "vy": vy, "wx": -vy / RADIUS, "wy": vx / RADIUS, "wz": 20.0}
        )
    return balls


SHOTS = {
    "slide": describe_shot(
        [{"x": 0.3, "y": 0.6, "vx": SPEED}], 6.0,
        {"sliding_friction": {"mu": SLIDE}, "rolling_resistance": {"mu": ROLL}},
    ),
    "head-on": describe_shot(
        [{"x": 0.5, "y": 0.6, "vx": 1.0}, {"x": 1.0, "y": 0.6}], 0.8, {"ball_restitution": {"e": 0.9}}
    ),
    "mirror": describe_shot(
        [{"x": 0.5, "y": 0.2, "vx": 0.6, "vy": -0.8}], 0.5, {"cushion_restitution": {"e": 0.8}}
    ),
    "four sides": describe_shot(
        turn_shot(), 0.25,
        {"cushion_restitution": {"e": 0.95}, "cushion_friction": {"mu": 0.16}, "ball_restitution": {"e": 0.95}},
        laws={"cushion": "mathavan_2010", "ball": "alciatore"},
    ),
    "throw": describe_shot(
        [{"x": 0.5, "y": 0.6, "vx": 1.0, "wz": 30.0}, {"x": 1.0, "y": 0.6}], 0.8, {"ball_restitution": {"e": 0.95}},
        laws={"ball": "alciatore"},
    ),
    "pocket": describe_shot([{"x": 0.4, "y": 0.4, "vx": -1.0, "vy": -1.0}], 1.0, {}, pockets=True),
    **{f"{hz} Hz": describe_shot([{"x": 0.3, "y": 0.6, "vx": 1.0}], 1.0, {}, hz=hz) for hz in RATES},
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Trajectory (T, N, 12) and rows of events of every shot, simulated in one process: a start takes two seconds."""
    folder, arguments, results = tmp_path_factory.mktemp("shots"), [], {}
    for name, shot in SHOTS.items():
        (folder / f"{name}.json").write_text(json.dumps(shot))
        arguments += [str(folder / f"{name}.json"), str(folder / name)]
    subprocess.run([sys.executable, str(WORLD), *arguments], check=True)
    for name, shot in SHOTS.items():
        with (folder / name / "trajectory.csv").open() as file:
            rows = [[float(x) for i, x in enumerate(row) if i != 1] for row in list(csv.reader(file))[1:]]
        with (folder / name / "events.csv").open() as file:
            events = list(csv.DictReader(file))
        results[name] = np.array(rows).reshape(-1, len(shot["balls"]), 13)[..., 1:], events
    return results


def test_a_sliding_ball_rolls_at_five_sevenths_of_its_speed_and_stops_where_it_should(runs: dict[str, Any]) -> None:
    samples, events = runs["slide"]
    until = 2 * SPEED / (7 * SLIDE * GRAVITY)
    slid = SPEED * until - SLIDE * GRAVITY * until**2 / 2
    rolling = 5 / 7 * SPEED
    x_end = 0.3 + slid + rolling**2 / (2 * ROLL * GRAVITY)
    assert samples[-1, 0, 0] == pytest.approx(x_end, abs=1e-4)
    assert events[-1]["kind"] == "rest"
    assert float(events[-1]["t"]) == pytest.approx(until + rolling / (ROLL * GRAVITY), abs=1e-3)
    k = int(1000 * (until + 0.05))
    assert samples[k, 0, 6] == pytest.approx(samples[k, 0, 3] / RADIUS, rel=1e-5)


def test_a_head_on_contact_keeps_momentum_and_loses_energy_by_the_restitution(runs: dict[str, Any]) -> None:
    samples, events = runs["head-on"]
    contact = events[1]
    assert float(contact["t"]) == pytest.approx(0.5 - 2 * RADIUS, abs=1e-6)
    assert samples[-1, :, 3] == pytest.approx([0.05, 0.95], abs=1e-9)


def test_the_mirror_law_reflects_and_shortens_the_normal_part(runs: dict[str, Any]) -> None:
    samples, events = runs["mirror"]
    assert samples[-1, 0, 3:5] == pytest.approx([0.6, 0.64], abs=1e-9)
    assert events[1]["b"] == "top"
    assert float(events[1]["t"]) == pytest.approx((0.2 - RADIUS) / 0.8, abs=1e-6)


def test_the_foreign_cushion_law_never_adds_energy_and_treats_all_sides_alike(runs: dict[str, Any]) -> None:
    samples, events = runs["four sides"]
    assert sorted(e["b"] for e in events if e["kind"] == "cushion") == ["bottom", "left", "right", "top"]
    v, w = samples[..., 3:5], samples[..., 5:8]
    energy = 0.5 * np.sum(v**2, axis=2) + 0.2 * RADIUS**2 * np.sum(w**2, axis=2)
    assert np.all(np.diff(energy, axis=0) < 1e-9)
    assert np.all(energy[-1] < 0.9 * energy[0])
    after = np.stack([turn.T @ velocity for turn, velocity in zip(TURNS, v[-1], strict=True)])
    assert np.ptp(after, axis=0) == pytest.approx([0, 0], abs=1e-4)


def test_throw_keeps_the_momentum_of_the_pair_and_turns_the_object_ball(runs: dict[str, Any]) -> None:
    samples, _ = runs["throw"]
    total = samples[-1, :, 3:5].sum(axis=0)
    assert total == pytest.approx([1.0, 0.0], abs=1e-9)
    # side spin that carries the front of the ball towards +y throws the object ball that way
    assert samples[-1, 1, 4] > 0.005


def test_a_ball_that_reaches_a_pocket_falls(runs: dict[str, Any]) -> None:
    samples, events = runs["pocket"]
    assert [(e["kind"], e["b"]) for e in events] == [("strike", ""), ("pocket", "top-left")]
    assert samples[-1, 0, 2] < -0.1


def test_samples_come_at_the_requested_rate(runs: dict[str, Any]) -> None:
    for hz in RATES:
        samples, _ = runs[f"{hz} Hz"]
        assert len(samples) == hz + 1
        assert samples[-1, 0, 0] == pytest.approx(1.3, abs=1e-6)


def test_an_unknown_parameter_is_refused(tmp_path: Path) -> None:
    shot = describe_shot([{"x": 0.4, "y": 0.4, "vx": 1.0}], 0.1, {"gravity_waves": {"k": 1.0}})
    (tmp_path / "shot.json").write_text(json.dumps(shot))
    command = [sys.executable, str(WORLD), str(tmp_path / "shot.json"), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode
    assert "gravity_waves" in done.stderr


def test_worlds_import_nothing_of_the_project() -> None:
    packages = {"models", "video", "detectors", "diagnosis", "pipeline"}
    for path in WORLD.parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        assert not {name.split(".")[0] for name in names} & packages
