"""`trueroll fit-table` learns a table from track folders, resumes, and refuses what is no table."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.scene import Table
from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics
from pipeline.cli.execute import execute_command_line

R, FPS, SECONDS = 0.03075, 50, 5.0
TABLE = Table("carom", "carom", 2.84, 1.42, R, 0.21, False)
EFFECTS = {
    "sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.006}, "spin_decay": {"rate": 5.0},
    "cushion_restitution": {"e": 0.9}, "cushion_friction": {"mu": 0.22}, "ball_restitution": {"e": 0.94},
}  # fmt: skip


def write_shots(folder: Path, count: int, length: float = 2.84) -> Path:
    """Write shots of one spinning ball that meets several cushions, with 0.5 mm of noise."""
    folder.mkdir(parents=True)
    physics = Physics.from_effects(EFFECTS, "han_2005", "inelastic")
    with (folder / "tracks.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("shot", "frame", "t", "id", "x", "y"))
        for shot in range(count):
            rng = np.random.default_rng([5, shot])
            angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 3.0)
            v = speed * np.array([np.cos(angle), np.sin(angle)])
            spin = [-v[1] / R, v[0] / R, rng.uniform(-0.6, 0.6) * speed / R]
            state = np.array([[rng.uniform(0.6, 2.2), rng.uniform(0.4, 1.0), *v, *spin]])
            run = simulate(BallSet(("white",), state, np.array([R]), np.array([0.21])), TABLE, physics, SECONDS)
            t = np.arange(int(SECONDS * FPS)) / FPS
            for frame, place in enumerate(run.states_at(t)[:, 0, :2] + rng.normal(0, 5e-4, (len(t), 2))):
                rows.writerow((shot, frame, t[frame], "white", *place))
    scene: dict[str, Any] = {
        "scene": "billiards", "units": "m", "fps": FPS, "ball_radius": R,
        "table": {"length": length, "width": 1.42, "pockets": False},
    }  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


@pytest.mark.slow
def test_a_table_is_learned_into_a_profile_that_predict_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, profile = write_shots(tmp_path / "shots", 5), tmp_path / "profile.json"
    command = ["fit-table", str(folder), "-o", str(profile), "--cache", str(tmp_path / "cache"), "--json"]
    assert execute_command_line(command) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["laws"]["cushion"] == "han_2005"
    assert document["effects"]["rolling_resistance"]["mu"]["value"] == pytest.approx(0.006, rel=0.05)
    assert document["learned_from"]["shots"] == 5
    assert document["correction"] == {"gain": None, "weights": []}  # too few contacts for a network
    first = profile.read_bytes()
    assert execute_command_line(command) == 0  # from the cache
    assert profile.read_bytes() == first
    predict = ["predict", str(folder), "--at", "2", "--seconds", "1", "-o", str(tmp_path / "out")]
    assert execute_command_line([*predict, "--profile", str(profile)]) == 0
    assert "white" in (tmp_path / "out" / "prediction.csv").read_text()


def test_shots_of_two_tables_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [str(write_shots(tmp_path / name, 1, length)) for name, length in (("one", 2.84), ("other", 2.54))]
    command = ["fit-table", *folders, "-o", str(tmp_path / "p.json"), "--cache", str(tmp_path / "c")]
    assert execute_command_line(command) == 2
    assert "one table is learned at a time" in capsys.readouterr().err
    assert not (tmp_path / "p.json").exists()


def test_a_folder_without_tracks_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute_command_line(["fit-table", str(tmp_path), "--cache", str(tmp_path / "c")]) == 2
    assert "tracks.csv was expected" in capsys.readouterr().err
