"""`trueroll simulate` writes its files, and names each mistake of a shot file in one line."""

from __future__ import annotations

import csv
import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.cli.execute import execute_command_line
from pipeline.io.shot_setup import read_shot_setup

SHOT: dict[str, Any] = {
    "scene": "billiards",
    "table": {"length": 2.54, "width": 1.27, "pockets": False},
    "seconds": 3.0,
    "hz": 500,
    "balls": [
        {"id": "cue", "x": 0.6, "y": 0.6, "vx": 2.0, "wz": 5.0, "radius": 0.028575, "mass": 0.17},
        {"id": "red", "x": 1.6, "y": 0.6},
    ],
    "effects": {"sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.01}, "ball_restitution": {"e": 0.95}},
    "laws": {"cushion": "mirror", "ball": "inelastic"},
}


def write_shot(folder: Path, shot: dict[str, Any]) -> Path:
    path = folder / "shot.json"
    path.write_text(json.dumps(shot), encoding="utf-8")
    return path


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_sliding_ball_arrives_at_the_time_of_the_closed_form(tmp_path: Path) -> None:
    """From 2 m/s without spin: it slides for 2 v / (7 mu g), then rolls at 5/7 v; it has 0.94285 m to go."""
    assert execute_command_line(["simulate", str(write_shot(tmp_path, SHOT)), "-o", str(tmp_path / "out")]) == 0
    contact = next(row for row in read_rows(tmp_path / "out" / "events.csv") if row["kind"] == "ball")
    g, v, way = 9.81, 2.0, 1.0 - 2 * 0.028575
    slide = 2 * v / (7 * 0.2 * g)
    slid, rolling = v * slide - 0.2 * g * slide**2 / 2, 5 / 7 * v
    a = 0.01 * g
    roll = (rolling - np.sqrt(rolling**2 - 2 * a * (way - slid))) / a
    assert float(contact["t"]) == pytest.approx(slide + roll, abs=2e-6)
    assert {contact["a"], contact["b"]} == {"cue", "red"}
    last = [row for row in read_rows(tmp_path / "out" / "trajectory.csv") if row["id"] == "red"][-1]
    assert float(last["t"]) == pytest.approx(3.0)
    assert (tmp_path / "out" / "plan.png").stat().st_size > 5000


def test_two_runs_write_the_same_bytes(tmp_path: Path) -> None:
    path = write_shot(tmp_path, SHOT)
    for name in ("one", "two"):
        assert execute_command_line(["simulate", str(path), "-o", str(tmp_path / name)]) == 0
    for name in ("trajectory.csv", "events.csv", "plan.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def change_shot(*path: Any, to: Any) -> dict[str, Any]:
    shot = deepcopy(SHOT)
    place: Any = shot
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    return shot


@pytest.mark.parametrize(
    ("shot", "words"),
    [
        (change_shot("effects", "gravity", to={"g": 9.0}), "gravity"),
        (change_shot("effects", "cushion_friction", to={"nu": 0.2}), "nu"),
        (change_shot("laws", "cushion", to="magic"), "magic"),
        (change_shot("laws", "ball", to="elastic"), "ball_restitution"),
        (change_shot("balls", 1, "x", to=0.61), "overlap"),
        (change_shot("balls", 1, "x", to=9.0), "cushion"),
        (change_shot("balls", 1, "id", to="cue"), "unique id"),
        (change_shot("balls", 0, "speed", to=1.0), "balls.0.speed"),
        (change_shot("balls", 0, "vx", to="fast"), "balls.0.vx"),
        (change_shot("balls", 0, "vx", to=float("nan")), "balls.0.vx"),
        (change_shot("balls", to=[]), "balls"),
        (change_shot("seconds", to=-1), "seconds"),
        (change_shot("hz", to=1e6), "lower hz"),
        (change_shot("table", to={"length": 1.0, "width": 2.0}), "longer side"),
        (change_shot("scene", to="flight"), "scene"),
    ],
)
def test_a_mistake_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], shot: dict[str, Any], words: str
) -> None:
    if words == "lower hz":
        shot["seconds"] = 1000
    assert execute_command_line(["simulate", str(write_shot(tmp_path, shot)), "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000])
def test_a_file_that_holds_no_shot_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    path = tmp_path / "shot.json"
    path.write_bytes(content)
    assert execute_command_line(["simulate", str(path), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_balls_without_size_are_those_of_the_nearest_table(tmp_path: Path) -> None:
    shot = read_shot_setup(
        write_shot(tmp_path, change_shot("table", to={"length": 2.84, "width": 1.42}) | {"balls": SHOT["balls"][1:]})
    )
    assert shot.balls.radius.tolist() == [0.03075]


@pytest.mark.parametrize(("seconds", "says"), [(2.0, True), (60.0, False)])
def test_what_still_moves_at_the_limit_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: float, says: bool
) -> None:
    shot = write_shot(tmp_path, change_shot("seconds", to=seconds))
    assert execute_command_line(["simulate", str(shot), "-o", str(tmp_path / "out")]) == 0
    assert ("still move" in (text := capsys.readouterr().out)) == says
    assert (f"at the limit of {seconds:g} s." in text) == says
