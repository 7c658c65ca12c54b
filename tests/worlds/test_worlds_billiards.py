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


def play(tmp_path: Path, balls: list[dict[str, Any]], seconds: float, effects: dict[str, Any], **shot: Any) -> Any:
    """Simulate a shot; returns the trajectory (T, N, 12) and the rows of events."""
    for i, ball in enumerate(balls):
        ball.update(id=ball.get("id", "abcd"[i]), radius=RADIUS)
    table = {"length": 2.54, "width": 1.27, "pockets": shot.pop("pockets", False)}
    text = {"table": table, "seconds": seconds, "hz": 1000, "balls": balls, "effects": effects, **shot}
    (tmp_path / "shot.json").write_text(json.dumps(text))
    subprocess.run([sys.executable, str(WORLD), str(tmp_path / "shot.json"), str(tmp_path / "out")], check=True)
    with (tmp_path / "out" / "trajectory.csv").open() as file:
        rows = [[float(x) for i, x in enumerate(row) if i != 1] for row in list(csv.reader(file))[1:]]
    with (tmp_path / "out" / "events.csv").open() as file:
        events = list(csv.DictReader(file))
    return np.array(rows).reshape(-1, len(balls), 13)[..., 1:], events


def test_a_sliding_ball_rolls_at_five_sevenths_of_its_speed_and_stops_where_it_should(tmp_path: Path) -> None:
    slide, roll, v = 0.2, 0.01, 0.7
    effects = {"sliding_friction": {"mu": slide}, "rolling_resistance": {"mu": roll}}
    samples, events = play(tmp_path, [{"x": 0.3, "y": 0.6, "vx": v}], 6.0, effects)
    until = 2 * v / (7 * slide * GRAVITY)
    slid = v * until - slide * GRAVITY * until**2 / 2
    rolling = 5 / 7 * v
    x_end = 0.3 + slid + rolling**2 / (2 * roll * GRAVITY)
    assert samples[-1, 0, 0] == pytest.approx(x_end, abs=1e-4)
    assert events[-1]["kind"] == "rest"
    assert float(events[-1]["t"]) == pytest.approx(until + rolling / (roll * GRAVITY), abs=1e-3)
    k = int(1000 * (until + 0.05))
    assert samples[k, 0, 6] == pytest.approx(samples[k, 0, 3] / RADIUS, rel=1e-5)


def test_a_head_on_contact_keeps_momentum_and_loses_energy_by_the_restitution(tmp_path: Path) -> None:
    balls = [{"x": 0.5, "y": 0.6, "vx": 1.0}, {"x": 1.0, "y": 0.6}]
    samples, events = play(tmp_path, balls, 0.8, {"ball_restitution": {"e": 0.9}})
    contact = events[1]
    assert float(contact["t"]) == pytest.approx(0.5 - 2 * RADIUS, abs=1e-6)
    assert samples[-1, :, 3] == pytest.approx([0.05, 0.95], abs=1e-9)


def test_the_mirror_law_reflects_and_shortens_the_normal_part(tmp_path: Path) -> None:
    ball = {"x": 0.5, "y": 0.2, "vx": 0.6, "vy": -0.8}
    samples, events = play(tmp_path, [ball], 0.5, {"cushion_restitution": {"e": 0.8}})
    assert samples[-1, 0, 3:5] == pytest.approx([0.6, 0.64], abs=1e-9)
    assert events[1]["b"] == "top"
    assert float(events[1]["t"]) == pytest.approx((0.2 - RADIUS) / 0.8, abs=1e-6)


def test_the_foreign_cushion_law_never_adds_energy_and_treats_all_sides_alike(tmp_path: Path) -> None:
    effects = {"cushion_restitution": {"e": 0.95}, "cushion_friction": {"mu": 0.16}, "ball_restitution": {"e": 0.95}}
    # four rolling balls, the same shot turned by quarter turns: right, bottom, left, top
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    turns = [np.linalg.matrix_power(quarter, k) for k in range(4)]
    gaps = [(2.3, 0.5), (1.2, 1.03), (0.24, 0.7), (1.5, 0.24)]
    balls = []
    for turn, (x, y) in zip(turns, gaps, strict=True):
        vx, vy = turn @ (1.5, 0.4)
        balls.append(
            {"id": f"{x}", "x": x, "y": y, "vx": vx, "vy": vy, "wx": -vy / RADIUS, "wy": vx / RADIUS, "wz": 20.0}
        )
    samples, events = play(tmp_path, balls, 0.25, effects, laws={"cushion": "mathavan_2010", "ball": "alciatore"})
    assert sorted(e["b"] for e in events if e["kind"] == "cushion") == ["bottom", "left", "right", "top"]
    v, w = samples[..., 3:5], samples[..., 5:8]
    energy = 0.5 * np.sum(v**2, axis=2) + 0.2 * RADIUS**2 * np.sum(w**2, axis=2)
    assert np.all(np.diff(energy, axis=0) < 1e-9)
    assert np.all(energy[-1] < 0.9 * energy[0])
    after = np.stack([turn.T @ velocity for turn, velocity in zip(turns, v[-1], strict=True)])
    assert np.ptp(after, axis=0) == pytest.approx([0, 0], abs=1e-4)


def test_throw_keeps_the_momentum_of_the_pair_and_turns_the_object_ball(tmp_path: Path) -> None:
    balls = [{"x": 0.5, "y": 0.6, "vx": 1.0, "wz": 30.0}, {"x": 1.0, "y": 0.6}]
    samples, _ = play(tmp_path, balls, 0.8, {"ball_restitution": {"e": 0.95}}, laws={"ball": "alciatore"})
    total = samples[-1, :, 3:5].sum(axis=0)
    assert total == pytest.approx([1.0, 0.0], abs=1e-9)
    # side spin that carries the front of the ball towards +y throws the object ball that way
    assert samples[-1, 1, 4] > 0.005


def test_a_ball_that_reaches_a_pocket_falls(tmp_path: Path) -> None:
    samples, events = play(tmp_path, [{"x": 0.4, "y": 0.4, "vx": -1.0, "vy": -1.0}], 1.0, {}, pockets=True)
    assert [(e["kind"], e["b"]) for e in events] == [("strike", ""), ("pocket", "top-left")]
    assert samples[-1, 0, 2] < -0.1


def test_an_unknown_parameter_is_refused(tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError):
        play(tmp_path, [{"x": 0.4, "y": 0.4, "vx": 1.0}], 0.1, {"gravity_waves": {"k": 1.0}})


def test_worlds_import_nothing_of_the_project() -> None:
    packages = {"models", "video", "detectors", "diagnosis", "pipeline"}
    for path in WORLD.parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        assert not {name.split(".")[0] for name in names} & packages


def test_samples_come_at_the_requested_rate(tmp_path: Path) -> None:
    for hz in (60, 120, 1020, 1000):
        samples, _ = play(tmp_path, [{"x": 0.3, "y": 0.6, "vx": 1.0}], 1.0, {}, hz=hz)
        assert len(samples) == hz + 1
        assert samples[-1, 0, 0] == pytest.approx(1.3, abs=1e-6)
