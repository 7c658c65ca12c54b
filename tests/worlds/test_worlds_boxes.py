"""The simulator of boxes against free fall, rigidity and conservation laws, run as a process like everywhere."""

from __future__ import annotations

import ast
import csv
import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from models.core.typing import FloatArray

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "boxes.py"
WIDE, TALL, FLOOR, RADIUS, GRAVITY = 24.0, 30.0, 330.0, 15.0, 981.0


@cache
def play(*options: str) -> tuple[FloatArray, list[str], FloatArray, dict[str, float]]:
    """Run the simulator; returns t (T,), names of N points, places (T, N, 2), and scene.json."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        subprocess.run([sys.executable, str(WORLD), str(out), *options], check=True)
        rows = list(csv.DictReader((out / "tracks.csv").read_text().splitlines()))
        facts = json.loads((out / "scene.json").read_text())
    names = list(dict.fromkeys(row["id"] for row in rows))
    places = np.array([[float(row["x"]), float(row["y"])] for row in rows]).reshape(-1, len(names), 2)
    return np.array([float(row["t"]) for row in rows])[:: len(names)], names, places, facts


def count_free_frames(places: FloatArray) -> int:
    """Count the frames before the ball reaches the first column of boxes."""
    return int(np.argmax(places[:, 0, 0] + RADIUS >= places[0, 1:, 0].min()))


def test_the_simulator_imports_nothing_of_the_project() -> None:
    tree = ast.parse(WORLD.read_text())
    modules = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name.split(".")[0] for name in modules} & {"models", "video", "pipeline", "detectors", "diagnosis"}


@pytest.mark.parametrize("speed", ["400", "800", "1600"])
def test_fifty_boxes_keep_their_shape_and_stay_within_the_boundary(speed: str) -> None:
    t, names, places, facts = play("--speed", speed)
    assert facts["speed"] == float(speed)
    assert (len(t), len(names)) == (151, 201)
    boxes = places[:, 1:].reshape(len(t), 50, 4, 2)
    sides = np.linalg.norm(boxes - np.roll(boxes, -1, axis=2), axis=3)
    assert np.abs(sides - [WIDE, TALL, WIDE, TALL]).max() < 1e-5
    assert boxes[..., 1].max() < FLOOR + 1.0
    assert places[:, 0, 1].max() < FLOOR - RADIUS + 1.0


def test_the_ball_flies_freely_until_it_hits_the_wall() -> None:
    _, _, places, _ = play("--speed", "800")
    ball = places[: count_free_frames(places), 0]
    assert len(ball) > 10
    assert np.diff(ball[:, 1], 2) * 60**2 == pytest.approx(GRAVITY, rel=1e-6)
    assert np.ptp(np.diff(ball[:, 0])) < 1e-6
    assert ball[-1, 0] < 200 - 2 + RADIUS


def test_boxes_that_nothing_has_reached_stand_still() -> None:
    _, _, places, _ = play("--speed", "400")
    before = places[: count_free_frames(places), 1:]
    assert len(before) > 20
    assert np.abs(before - places[0, 1:]).max() < 0.05


def test_the_same_seed_gives_the_same_shot_and_another_a_different_one() -> None:
    second = play("--speed", "800")[2][:61]
    assert np.array_equal(second[::2], play("--speed", "800", "--seconds", "1", "--hz", "30")[2])
    assert np.abs(second - play("--speed", "800", "--seconds", "1", "--seed", "1")[2]).max() > 1.0
