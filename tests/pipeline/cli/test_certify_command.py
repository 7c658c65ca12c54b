"""`trueroll certify` measures a simulated table, and finds what differs from an earlier certificate."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from support.pseudo_terminal import Terminal, make_terminal
from support.shot_folders import EFFECTS, write_shots

from models.estimation.table_learning.table_measurements import compute_roll_out
from pipeline.io.run_folder import drop_repeated_clips, find_repeated_clips, list_folders_with

trueroll = pytest.fixture(make_terminal)
SLOPE = 1.2
"""mm/m along the length."""


@pytest.mark.slow
def test_a_simulated_table_gets_its_true_numbers_and_a_changed_one_is_told_apart(
    trueroll: Terminal, tmp_path: Path
) -> None:
    shots = write_shots(tmp_path / "shots", 6, effects={**EFFECTS, "slope": {"slope_x": SLOPE, "slope_y": 0.0}})
    command = ["certify", shots, "-o", tmp_path / "out", "--cache", tmp_path / "cache", "--json"]
    output = trueroll(*command)
    assert output.status == 0
    document = json.loads(output.out)
    numbers = document["numbers"]
    assert json.loads((tmp_path / "out" / "certificate.json").read_text()) == document
    for name, truth in (("slope_x", SLOPE), ("slope_y", 0.0), ("roll_out", compute_roll_out(0.006, 0.0, 2.0)),
                        ("sliding_friction", 0.2), ("length", 2.84), ("width", 1.42)):  # fmt: skip
        if numbers[name]["value"] is not None:
            assert abs(numbers[name]["value"] - truth) < 4 * numbers[name]["sigma"], name
    assert numbers["slope_x"]["sigma"] < 0.2
    assert 0.80 < numbers["restitution"]["value"] < 0.92  # 0.9, less what the spin of a rolling ball takes
    assert document["pocket_openings"]["observable"] is False
    page = (tmp_path / "out" / "certificate.html").read_text()
    assert "certificate of the table" in page
    assert "Cannot be measured: the table has no pockets." in page
    assert 'src="http' not in page
    earlier = tmp_path / "earlier.json"
    numbers["slope_x"]["value"] -= SLOPE
    earlier.write_text(json.dumps(document))
    again = trueroll(*command[:-1], "--compare", earlier)
    assert "Beyond their errors these numbers differ from earlier: slope along the length" in again.out
    assert 'class="differs"' in (tmp_path / "out" / "certificate.html").read_text()


def test_two_runs_of_one_clip_count_once(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("good", "fixed", "part", "other")]
    for folder, digest, first in zip(folders, ("a", "a", "a", "b"), (0, 0, 90, 0), strict=True):
        folder.mkdir()
        (folder / "scene.json").write_text(json.dumps({"clip": {"sha256": digest}}))
        (folder / "source.json").write_text(json.dumps({"path": "clip.mp4", "first": first}))
    kept, sentences = drop_repeated_clips(folders)
    assert [folder.name for folder in kept] == ["good", "part", "other"]
    assert sentences == [f"{folders[1]} has the same clip or tracks as {folders[0]}: its shots are counted once"]


def test_a_copy_of_a_track_folder_counts_once(tmp_path: Path) -> None:
    shots = tmp_path / "shots"
    shots.mkdir()
    (shots / "tracks.csv").write_text("frame,t,id,x,y\n0,0,white,1,0.5\n")
    copy = Path(shutil.copytree(shots, tmp_path / "copy"))
    assert find_repeated_clips([shots, shots / "tracks.csv", copy]) == {shots / "tracks.csv": shots, copy: shots}


def test_run_folders_of_a_batch_are_listed_once(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / "batch" / name).mkdir(parents=True)
        (tmp_path / "batch" / name / "tracks.csv").touch()
    folders = list_folders_with("tracks.csv", [tmp_path / "batch" / "b", tmp_path / "batch"])
    assert [folder.name for folder in folders] == ["b", "a"]


@pytest.mark.parametrize(
    ("options", "words"),
    [((), "holds no tracks.csv"), (("--compare", "nothing.json"), "--compare wants a certificate.json")],
)
def test_wrong_usage_is_one_sentence(trueroll: Terminal, tmp_path: Path, options: tuple[str, ...], words: str) -> None:
    output = trueroll("certify", tmp_path, *options, "-o", tmp_path / "out")
    assert output.status == 2
    assert words in output.err
    assert not (tmp_path / "out").exists()
