"""The simulators of bodies: their track folders follow textbook motion."""

from __future__ import annotations

import csv
import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

WORLDS = Path(__file__).parents[2] / "worlds"


@pytest.fixture(autouse=True)
def import_from_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the scripts find what is beside them, as in a process of their own."""
    monkeypatch.syspath_prepend(WORLDS)


def play_world(folder: Path, world: str, **experiment: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run an experiment in this process; returns shot, time and positions of all rows."""
    experiment_file = folder / "experiment.json"
    experiment_file.write_text(json.dumps({"noise": 0.0, "shots": 3, "seconds": 1.0, **experiment}))
    script = str(WORLDS / f"{world}.py")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [script, str(experiment_file), str(folder / "out")])
        runpy.run_path(script, run_name="__main__")
    with (folder / "out" / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name not in ("shot", "frame", "t", "id")]
    places = np.array([[float(row[name]) for name in names] for row in rows])
    return np.array([int(row["shot"]) for row in rows]), np.array([float(row["t"]) for row in rows]), places


def test_a_sliding_body_stops_where_friction_stops_it(tmp_path: Path) -> None:
    shot, t, xy = play_world(tmp_path, "slide", effects={"sliding_friction": {"mu": 0.3}})
    for one in range(3):
        own, when = xy[shot == one], t[shot == one]
        speed = np.linalg.norm(own[1] - own[0]) / when[1] + 0.5 * 0.3 * 9.81 * when[1]
        way = np.linalg.norm(own[-1] - own[0])
        assert way == pytest.approx(speed**2 / (2 * 0.3 * 9.81), abs=1e-4)


def test_a_thrown_body_without_air_is_a_parabola(tmp_path: Path) -> None:
    shot, t, xy = play_world(tmp_path, "flight", effects={})
    for one in range(3):
        own, when = xy[shot == one], t[shot == one]
        curve = np.polynomial.Polynomial.fit(when, own[:, 1], 2).convert().coef
        assert curve[2] == pytest.approx(-9.81 / 2, abs=1e-5)
        assert np.ptp(np.diff(own[:, 0])) < 1e-7


def test_a_rod_without_friction_keeps_its_energy(tmp_path: Path) -> None:
    shot, _, angle = play_world(tmp_path, "pendulum", effects={}, fps=500.0)
    for one in range(3):
        own = angle[shot == one, 0]
        turning = (own[2:] - own[:-2]) * 250
        energy = 0.5 * turning**2 - 1.5 * 9.81 / 0.3 * np.cos(own[1:-1])
        assert np.ptp(energy) < 0.02 * np.ptp(turning**2)


def test_noise_outliers_and_gaps_are_as_requested(tmp_path: Path) -> None:
    settings = {
        "effects": {}, "shots": 40, "seconds": 0.5, "fps": 240.0, "noise": 0.01, "outliers": 0.02, "missing": 0.1,
    }  # fmt: skip
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    _, _, observed = play_world(tmp_path / "a", "slide", **{**settings, "missing": 0.0})
    _, _, true = play_world(tmp_path / "b", "slide", **{**settings, "missing": 0.0, "outliers": 0.0, "noise": 0.0})
    off = (observed - true)[:, 0]
    assert 1.4826 * np.median(np.abs(off)) == pytest.approx(0.01, rel=0.05)
    assert np.mean(np.abs(off) > 0.05) == pytest.approx(0.016, abs=0.006)
    _, t, _ = play_world(tmp_path / "b", "slide", **settings)
    assert len(t) == pytest.approx(0.9 * len(observed), rel=0.02)


def test_an_effect_that_a_simulator_lacks_is_refused(tmp_path: Path) -> None:
    experiment_file = tmp_path / "experiment.json"
    experiment_file.write_text(json.dumps({"effects": {"magic": {}}}))
    done = subprocess.run(
        [sys.executable, str(WORLDS / "slide.py"), str(experiment_file), str(tmp_path / "out")],
        capture_output=True,
        text=True,
    )
    assert done.returncode
    assert "magic" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "effects",
    [
        {"joint_friction": {"viscous": 0.1, "dry": 0.0}, "air_drag": {"k": 0.05}},
        {"joint_friction": {"viscous": 0.0, "dry": 0.2}, "gravity_tilt": {"angle": 0.03}},
    ],
)
def test_mujoco_swings_the_same_rod(effects: dict[str, dict[str, float]], tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "ours").mkdir()
    (tmp_path / "theirs").mkdir()
    _, _, ours = play_world(tmp_path / "ours", "pendulum", effects=effects, seconds=2.0)
    _, _, theirs = play_world(tmp_path / "theirs", "pendulum_mujoco", effects=effects, seconds=2.0)
    assert np.abs(ours - theirs).max() < 1e-3  # rad; dry friction is soft in MuJoCo


def split_shots(shot: np.ndarray, t: np.ndarray, values: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(t[shot == one], values[shot == one]) for one in np.unique(shot)]


@pytest.mark.parametrize("fps", [60.0, 5.0])  # at 5 fps there are several contacts between two frames
def test_elastic_walls_fold_a_straight_path(tmp_path: Path, fps: float) -> None:
    box = {"walls": [-0.3, -0.2, 0.3, 0.2], "radius": 0.05}
    throw = {"speed": 2.0}
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    free = play_world(tmp_path / "a", "slide", effects={}, throw=throw, seed=4, fps=fps)
    held = play_world(tmp_path / "b", "slide", effects={}, throw=throw, seed=4, facts=box, fps=fps)
    for axis, side in enumerate((0.25, 0.15)):
        # a start outside the box is none of a body between walls
        inside = np.isin(
            free[0], [one for one in range(3) if np.abs(free[2][free[0] == one][0] / [0.25, 0.15]).max() < 1]
        )
        away = (free[2][inside, axis] + side) / (2 * side)
        folded = side * (1 - 2 * np.abs(1 - away % 2))
        assert inside.any()
        assert np.allclose(held[2][inside, axis], folded, atol=1e-6)


def test_a_wall_keeps_its_share_of_the_normal_speed_and_rubs(tmp_path: Path) -> None:
    effects = {"wall_restitution": {"e": 0.7}, "wall_friction": {"mu": 0.1}}
    facts = {"walls": [-9, -9, 0.4, 9], "radius": 0.0}
    rows = play_world(tmp_path, "slide", effects=effects, throw={"angle": 0.3, "speed": 1.5}, facts=facts)
    closing, along = 1.5 * np.cos(0.3), 1.5 * np.sin(0.3)
    for _, xy in split_shots(*rows):
        before, after = (xy[1] - xy[0]) * 60, (xy[-1] - xy[-2]) * 60
        assert np.allclose(before, [closing, along], atol=1e-5)
        assert np.allclose(after, [-0.7 * closing, along - 0.1 * 1.7 * closing], atol=1e-5)


def test_a_body_without_friction_stays_behind_a_platform(tmp_path: Path) -> None:
    drive = {"platform_x": {"amplitude": 0.05, "frequency": 2.0}}
    rows = play_world(tmp_path, "slide", effects={}, drive=drive)
    for _, values in split_shots(*rows):
        assert np.ptp(values[:, 2]) > 0.09
        assert np.ptp(np.diff(values[:, 0] + values[:, 2])) < 1e-6


def test_a_force_accelerates_a_body(tmp_path: Path) -> None:
    rows = play_world(tmp_path, "slide", effects={}, drive={"force_y": {"amplitude": 2.0, "frequency": 1.0}}, fps=500.0)
    for _, values in split_shots(*rows):
        assert np.allclose(np.diff(values[:, 1], 2) * 500**2, values[1:-1, 2], atol=2e-2)


def test_a_driven_rod_obeys_torque_and_pivot(tmp_path: Path) -> None:
    drive = {
        "torque": {"amplitude": 5.0, "frequency": 1.0},
        "pivot_x": {"amplitude": 0.02, "frequency": 1.5},
        "pivot_y": {"amplitude": 0.01, "frequency": 2.0},
    }
    rows = play_world(tmp_path, "pendulum", effects={}, drive=drive, fps=500.0)
    for _, values in split_shots(*rows):
        angle, torque, x, y = values.T
        turned, right, up = (np.diff(one, 2) * 500**2 for one in (angle, x, y))
        middle = angle[1:-1]
        expected = torque[1:-1] - 5.0 * ((9.81 + up) * np.sin(middle) + right * np.cos(middle))
        assert np.allclose(turned, expected, atol=0.05)


def test_inputs_that_are_not_stated_are_not_written(tmp_path: Path) -> None:
    drive = {"torque": {"amplitude": 5.0, "frequency": 1.0}}
    _, _, values = play_world(tmp_path, "pendulum", effects={}, drive=drive, stated=False)
    assert values.shape[1] == 1
