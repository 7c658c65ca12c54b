"""`trueroll diagnose` on track folders writes files that keep the contract, and refuses bad input in one line."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.pseudo_terminal import Terminal, make_terminal

trueroll = pytest.fixture(make_terminal)
pytestmark = pytest.mark.usefixtures("alone")

COLUMNS = "shot,window,frame,t,id,x,y,x_before,y_before,x_after,y_after"
PUSHES = ((1.2, 0.3), (0.9, -0.8), (-1.1, 0.2), (0.4, 1.0), (-0.7, -0.9), (1.0, 0.9))


def write_slides(folder: Path, drag: float, shots: int = 6) -> Path:
    """Write the tracks of bodies pushed over a plane with viscous drag (1/s), observed with an error of 0.5 mm."""
    folder.mkdir()
    rng = np.random.default_rng(3)
    t = np.arange(30) / 30
    rows = []
    for shot, push in enumerate(PUSHES[:shots]):
        path = solve_ivp(lambda _, s: [s[2], s[3], -drag * s[2], -drag * s[3]], (0, t[-1]), [0, 0, *push], t_eval=t)
        observed = path.y[:2].T + 5e-4 * rng.standard_normal((len(t), 2))
        rows += [(shot, k, t[k], "cube", *observed[k]) for k in range(len(t))]
    with (folder / "tracks.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("shot", "frame", "t", "id", "x", "y"), *rows])
    (folder / "scene.json").write_text(json.dumps({"scene": "slide", "units": "m", "fps": 30}))
    return folder


def rms(rows: list[dict[str, str]], kind: str) -> float:
    misses = [math.hypot(*(float(row[axis]) - float(row[axis + kind]) for axis in "xy")) for row in rows]
    return math.sqrt(sum(miss**2 for miss in misses) / len(misses))


def test_the_files_name_the_effect_and_let_anyone_recompute_the_gap(trueroll: Terminal, tmp_path: Path) -> None:
    folder = write_slides(tmp_path / "pushed", 0.8)
    assert trueroll("diagnose", folder, "-o", tmp_path / "gap").status == 0
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert gap["verdict"] in ("effects", "group")
    assert "viscous_drag" in gap["candidates"][0]["group"]
    assert {"none", "unknown"} <= {one["effect"] for one in gap["candidates"]}
    assert math.isclose(gap["fitted"]["viscous_drag.k"]["value"], 0.8, rel_tol=0.02)
    with (tmp_path / "gap" / "gap_predictions.csv").open(newline="") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        assert set(COLUMNS.split(",")) <= set(reader.fieldnames or [])
    assert {int(row["shot"]) for row in rows} <= set(gap["gap"]["held_out_shots"])
    assert math.isclose(rms(rows, "_before"), gap["gap"]["before"], rel_tol=1e-3)
    assert math.isclose(rms(rows, "_after"), gap["gap"]["after"], rel_tol=1e-3)
    page = (tmp_path / "gap" / "gap.html").read_text()
    assert "Your simulator lacks viscous drag" in page
    assert 'src="http' not in page
    (strength,) = re.findall(r"k = (0\.\d+) ± [\d.]+ 1/s</td>", page)
    assert math.isclose(float(strength), 0.8, rel_tol=0.02), "the strength stands beside its cause"
    assert "method" not in page.partition("<body>")[2].partition("<script")[0]


def test_a_clip_in_place_of_a_folder_is_refused(trueroll: Terminal, tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(b"")
    done = trueroll("diagnose", tmp_path / "clip.mp4")
    assert done.status == 2
    assert "clip.mp4 is none of these" in done.err
    assert "a clip needs trueroll run first" in done.err


def test_a_file_of_another_program_is_diagnosed_as_it_is(trueroll: Terminal, tmp_path: Path) -> None:
    """A table of text keeps its further columns, and a project of pooltool its table; both say what was read."""
    folder = write_slides(tmp_path / "slides", 0.8)
    lines = (folder / "tracks.csv").read_text().replace("shot,frame,t,id", "trial;frame;Time (s);particle")
    (tmp_path / "pucks.txt").write_text(lines.replace(",", ";"))
    refusal = trueroll("diagnose", tmp_path / "pucks.txt").err
    assert "state --scene (billiards, flight" in refusal
    assert "--simulator" in refusal, "the way of who has recorded joints"
    done = trueroll("diagnose", tmp_path / "pucks.txt", "--scene", "slide")
    assert done.status == 0
    assert "pucks.txt was read as a table of text, of the scene slide" in done.out
    assert "particle is read as id" in done.out
    assert "metres are assumed" in done.out
    gaps = [json.loads((one / "gap.json").read_text()) for one in (tmp_path / "pucks-gap",)]
    assert gaps[0]["effects"] == ["viscous_drag"]


def test_one_short_shot_is_undecidable(trueroll: Terminal, tmp_path: Path) -> None:
    folder = write_slides(tmp_path / "short", 0.8, shots=1)
    lines = (folder / "tracks.csv").read_text().splitlines()
    (folder / "tracks.csv").write_text("\n".join(lines[:6]) + "\n")
    assert trueroll("diagnose", folder, "-o", tmp_path / "gap").status == 0
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "undecidable"


def test_one_shot_leaves_none_to_check_an_effect_on(trueroll: Terminal, tmp_path: Path) -> None:
    folder = write_slides(tmp_path / "one", 0.8, shots=1)
    output = trueroll("diagnose", folder, "-o", tmp_path / "gap")
    assert "one shot leaves none to check an effect on" in output.out
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "undecidable"


@pytest.mark.parametrize("option", [("--scene", "slide"), ("--fps", "100"), ("--px-per-m", "300")])
def test_options_of_tracks_are_refused_beside_a_simulator_of_joints_and_nothing_is_left(
    trueroll: Terminal, tmp_path: Path, option: tuple[str, str]
) -> None:
    (tmp_path / "real.csv").write_text("t,q\n0,0\n")
    done = trueroll("diagnose", tmp_path / "real.csv", "--simulator", "model:step", *option, "-o", tmp_path / "gap")
    assert done.status == 2
    assert "leave them out" in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "gap").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": "curling"}, "scene"),
        ({"model": ["magnetism"]}, "magnetism"),
        ({"units": "px"}, "px_per_m"),
    ],
)
def test_an_input_that_cannot_be_diagnosed_is_refused_in_one_line(
    trueroll: Terminal, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    folder = write_slides(tmp_path / "pushed", 0.8, shots=2)
    entry = json.loads((folder / "scene.json").read_text()) | change
    (folder / "scene.json").write_text(json.dumps(entry))
    done = trueroll("diagnose", folder)
    assert done.status != 0
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
