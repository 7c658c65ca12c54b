"""Track folders: what is read, and what is refused with a sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from models.errors import OptionError
from pipeline.track_folder import read_track_folders

ROWS = "0,0,0.0,cue,1.0,0.5\n0,1,0.1,cue,1.1,0.5\n"


def folder(place: Path, length: float = 2.54, radius: float | None = 0.028575, columns: str = "x,y") -> Path:
    place.mkdir()
    scene = {"scene": "billiards", "table": {"length": length, "width": length / 2}, "ball_radius": radius}
    (place / "scene.json").write_text(json.dumps(scene))
    (place / "tracks.csv").write_text(f"shot,frame,t,id,{columns}\n{ROWS}")
    return place


def test_shots_of_one_table_are_numbered_through(tmp_path: Path) -> None:
    read = read_track_folders([folder(tmp_path / "a"), folder(tmp_path / "b", 2.55, None)])
    assert [one.shot for one in read.recordings] == [0, 1]
    assert read.coordinates == ("x", "y")


@pytest.mark.parametrize(("length", "radius"), [(2.84, 0.028575), (2.54, 0.03075)])
def test_shots_of_different_tables_are_not_put_together(tmp_path: Path, length: float, radius: float) -> None:
    first, other = folder(tmp_path / "a"), folder(tmp_path / "b", length, radius)
    with pytest.raises(OptionError, match=f"{length:.3g} x .* balls of {2e3 * radius:.3g} mm.*; diagnose tables apart"):
        read_track_folders([first, other])


@pytest.mark.parametrize("columns", ["x,w", "w,y"])
def test_a_missing_coordinate_is_said(tmp_path: Path, columns: str) -> None:
    with pytest.raises(OptionError, match="needs the columns id and x, y"):
        read_track_folders([folder(tmp_path / "a", columns=columns)])
