"""Track folders: reading, and errors in one sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import staged_shot

from models.core.errors import OptionError
from models.core.shot import Shot
from models.core.trajectory import CaptureClock
from pipeline.io.long_recordings import cut_pendulums
from pipeline.io.saved_shot import write_shot
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

ROWS = "0,0,0.0,cue,1.0,0.5\n0,1,0.1,cue,1.1,0.5\n"
OTHER_ROWS = "0,0,0.0,cue,1.0,0.5\n0,1,0.1,cue,1.2,0.5\n"


def folder(
    place: Path, length: float = 2.54, radius: float | None = 0.028575, columns: str = "x,y", rows: str = ROWS
) -> Path:
    place.mkdir()
    scene = {"scene": "billiards", "table": {"length": length, "width": length / 2}, "ball_radius": radius}
    (place / "scene.json").write_text(json.dumps(scene))
    (place / "tracks.csv").write_text(f"shot,frame,t,id,{columns}\n{rows}")
    return place


def test_shots_of_one_table_are_numbered_through(tmp_path: Path) -> None:
    read = read_track_folders([folder(tmp_path / "a"), folder(tmp_path / "b", 2.55, None, rows=OTHER_ROWS)])
    assert read.origins == {0: "a", 1: "b"}
    assert [one.shot for one in read.recordings] == [0, 1]
    assert read.reference.coordinates == ("x", "y")


@pytest.mark.parametrize(("scene", "count"), [("pendulum", 4), ("slide", 1)])
def test_a_long_recording_of_a_pendulum_is_cut_into_shots(tmp_path: Path, scene: str, count: int) -> None:
    """A body that slides is at rest in the end: its pieces would say nothing of the same motion."""
    rows = [f"2,{k},{k / 100:.2f},bob,{np.sin(k / 20):.4f},{np.cos(k / 20):.4f}" for k in range(400)]
    place = tmp_path / "a"
    place.mkdir()
    names = "angle,other" if scene == "pendulum" else "x,y"
    (place / "scene.json").write_text(json.dumps({"scene": scene}))
    (place / "tracks.csv").write_text("\n".join([f"shot,frame,t,id,{names}", *rows]) + "\n")
    read = cut_pendulums(read_track_folders([place]))
    assert len(read.recordings) == count
    assert sum(len(one.t) for one in read.recordings) == 400
    assert bool(read.origins) == (count > 1)


def test_a_saved_shot_is_read_at_full_precision_and_without_positions_from_physics(tmp_path: Path) -> None:
    """The table rounds, and its last row is one that physics filled in."""
    source, t = folder(tmp_path / "a"), np.arange(5) / 30
    tracks = staged_shot.tracks(t)
    tracks = replace(tracks, xy=tracks.xy + np.pi * 1e-8)
    tracks.xy[4, 0] = np.nan
    rows = [f"0,{k},{t[k]:.6f},{name},{x:.6f},{y:.6f}" for k in range(5) for name, (x, y) in
            zip(tracks.ids, np.nan_to_num(tracks.xy[k], nan=0.5), strict=True)]  # fmt: skip
    (source / "tracks.csv").write_text("\n".join(["shot,frame,t,id,x,y", *rows]) + "\n")
    (by_table,) = read_track_folders([source]).recordings
    blank = np.full((*tracks.xy.shape, 2), np.nan)
    write_shot(Shot(staged_shot.scene(), tracks, CaptureClock(t, t, 0 * t), blank, None), {}, "1", source)
    (by_shot,) = read_track_folders([source]).recordings
    assert by_table.bodies == by_shot.bodies == tracks.ids
    assert np.array_equal(by_shot.positions, tracks.xy, equal_nan=True)
    assert 0 < np.abs(by_shot.positions - by_table.positions)[:4].max() < 1e-6
    assert by_table.is_observed[4, 0]
    assert not by_shot.is_observed[4, 0]


def test_recordings_in_other_coordinates_are_not_put_together(tmp_path: Path) -> None:
    first, other = (folder(tmp_path / name, columns=f"x,{axis}") for name, axis in (("a", "z"), ("b", "y")))
    for one in (first, other):
        (one / "scene.json").write_text(json.dumps({"scene": "flight"}))
    assert read_track_folders([first]).reference.coordinates == ("x", "z")
    with pytest.raises(OptionError, match=r"b has x, y \(m\) in the air, and .*a has x, z \(m\) in the air; diagnose"):
        read_track_folders([first, other])


def test_a_folder_that_is_given_twice_does_not_confirm_itself(tmp_path: Path) -> None:
    one = folder(tmp_path / "a")
    with pytest.raises(OptionError, match="given twice"):
        read_track_folders([one, tmp_path / "." / "a" / ".." / "a"])


@pytest.mark.parametrize("clip", [{"sha256": "a"}, None])
def test_two_runs_of_one_clip_and_a_copy_of_tracks_count_once(tmp_path: Path, clip: dict[str, str] | None) -> None:
    folders = [
        folder(tmp_path / "good"),
        folder(tmp_path / "again", rows=OTHER_ROWS if clip else ROWS),  # of a run with other options
        folder(tmp_path / "other", rows=OTHER_ROWS.replace("1.2", "1.3")),
    ]
    for one in folders[: 2 if clip else 0]:
        scene = json.loads((one / "scene.json").read_text())
        (one / "scene.json").write_text(json.dumps({**scene, "clip": clip}))
    read = read_track_folders(folders)
    assert read.origins == {0: "good", 1: "other"}
    assert [one.positions[1, 0, 0] for one in read.recordings] == [1.1, 1.3]
    assert read.notes == (f"{folders[1]} has the same clip or tracks as {folders[0]}: its shots are counted once",)
    assert not read_track_folders(folders[:2]).origins, "one folder is left"


def test_shots_with_the_same_rows_count_once(tmp_path: Path) -> None:
    again = ROWS.replace("0,0,0.0", "4,0,0.0").replace("0,1,0.1", "4,1,0.1")
    one = folder(tmp_path / "a", rows=OTHER_ROWS + again)
    (alone,) = read_track_folders([folder(tmp_path / "b", rows=ROWS + again)]).recordings
    assert alone.shot == 0
    read = read_track_folders([one, tmp_path / "b"])
    assert read.origins == {0: "a, shot 0", 1: "a, shot 4"}
    assert len(read.recordings) == 2
    assert read.notes == (
        "b, shot 0 has the same rows as a, shot 4; b, shot 4 has the same rows as a, shot 4:"
        " such shots are counted once",
    )


@pytest.mark.parametrize(("length", "radius"), [(2.84, 0.028575), (2.54, 0.03075)])
def test_shots_of_different_tables_are_not_put_together(tmp_path: Path, length: float, radius: float) -> None:
    first, other = folder(tmp_path / "a"), folder(tmp_path / "b", length, radius)
    with pytest.raises(
        OptionError, match=f"{length:.3g} x .* balls of {2e3 * radius:.3g} mm.*; diagnose each table separately"
    ):
        read_track_folders([first, other])


@pytest.mark.parametrize("columns", ["x,w", "w,y"])
def test_a_missing_coordinate_is_named(tmp_path: Path, columns: str) -> None:
    with pytest.raises(OptionError, match="needs the columns id and x, y"):
        read_track_folders([folder(tmp_path / "a", columns=columns)])


def off(place: Path, x: float, y: float = 1.0, rows: int = 20) -> Path:
    """A folder whose last row lies elsewhere, or whose rows are all scaled by x and y if `rows` is 0."""
    source = folder(place)
    positions = [(1.0 + 0.05 * k, 0.5 + 0.02 * k) for k in range(rows or 20)]
    if rows:
        positions[-1] = (x, y)
    else:
        positions = [(x * a, y * b) for a, b in positions]
    lines = (f"0,{k},{k / 30},cue,{a},{b}" for k, (a, b) in enumerate(positions))
    (source / "tracks.csv").write_text("\n".join(["shot,frame,t,id,x,y", *lines]) + "\n")
    return source


@pytest.mark.parametrize(("times", "unit", "short"), [(100, "centimetres", "cm"), (1000, "millimetres", "mm")])
def test_positions_in_another_unit_are_recognised_and_refused_where_metres_are_stated(
    tmp_path: Path, times: float, unit: str, short: str
) -> None:
    pattern = f'x goes from {times:.3g} .*length of 2.54 m, so that x lies .*{unit}, write "units": "{short}" into'
    source = off(tmp_path / "a", times, times, rows=0)
    (read,) = read_track_folders([source]).recordings
    assert np.allclose(read.positions[[0, -1], 0], [[1.0, 0.5], [1.95, 0.88]])
    assert read_track_folders([source]).notes == (f"{source / 'tracks.csv'}: positions fit on the table in {unit}",)
    (source / "scene.json").write_text((source / "scene.json").read_text().replace("{", '{"units": "m",', 1))
    with pytest.raises(OptionError, match=pattern.replace("+", r"\+")):
        read_track_folders([source])


def test_exchanged_columns_are_refused_by_the_one_that_does_not_fit(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"y goes from 2 to .* a width of 1.27 m"):
        read_track_folders([off(tmp_path / "a", 0.5, 4.0, rows=0)])


def test_a_table_that_is_not_in_metres_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"254 x 127 m; lengths must be in metres"):
        read_track_folders([folder(tmp_path / "a", length=254.0)])


def test_a_ball_that_flies_off_is_a_note_and_one_that_is_shifted_none(tmp_path: Path) -> None:
    assert read_track_folders([off(tmp_path / "a", 3.5)]).notes == (
        f"1 of 20 positions of {tmp_path / 'a' / 'tracks.csv'} are off the table",
    )
    assert read_track_folders([off(tmp_path / "b", 2.6)]).notes == ()


def test_where_no_table_is_named_any_place_may_be(tmp_path: Path) -> None:
    source = off(tmp_path / "a", 20.0, 20.0, rows=0)
    (source / "scene.json").write_text(json.dumps({"scene": "slide", "units": "m"}))
    assert read_track_folders([source]).notes == ()


@pytest.mark.parametrize(
    ("there", "words"),
    [
        (
            ("scene.json",),
            "There is no tracks.csv in .*a; a diagnosis needs tracks.csv .* docs/reference/file-formats.md",
        ),
        (("tracks.csv",), "There is no scene.json in .*a; a diagnosis needs"),
        ((), "There is no tracks.csv and no scene.json in .*a; a diagnosis needs"),
    ],
)
def test_a_missing_file_is_named_with_where_it_was_sought(tmp_path: Path, there: tuple[str, ...], words: str) -> None:
    source = folder(tmp_path / "a")
    for name in {"tracks.csv", "scene.json"} - set(there):
        (source / name).unlink()
    with pytest.raises(OptionError, match=words):
        read_track_folders([source])


def test_who_names_the_folder_above_is_led_to_those_below(tmp_path: Path) -> None:
    folder(tmp_path / "a")
    folder(tmp_path / "b")
    with pytest.raises(OptionError, match=r"but in 2 of its folders; name these: .*/\*/"):
        read_track_folders([tmp_path])


def test_nothing_in_place_of_a_folder_is_reported_as_that(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"There is no folder .*nowhere; name one"):
        read_track_folders([tmp_path / "nowhere"])


def with_laws(place: Path, **more: object) -> Path:
    source = folder(place)
    scene = json.loads((source / "scene.json").read_text())
    (source / "scene.json").write_text(json.dumps({**scene, **more}))
    return source


def test_the_contact_models_of_a_simulator_are_its_own(tmp_path: Path) -> None:
    laws = {"cushion": "han_2005", "ball": "elastic"}
    scene = build_gap_scene(read_track_folders([with_laws(tmp_path / "own", laws=laws)]))
    assert [one.simulator_form for one in scene.alternatives] == ["han_2005", "elastic"]
    run = build_gap_scene(read_track_folders([with_laws(tmp_path / "run", laws=laws, calibration={})]))
    assert [one.simulator_form for one in run.alternatives] == ["mirror", "inelastic"]


@pytest.mark.parametrize("laws", [{"cushion": "rubber"}, {"cloth": "mirror"}])
def test_a_contact_model_that_does_not_exist_is_named(tmp_path: Path, laws: dict[str, str]) -> None:
    with pytest.raises(OptionError, match=r"cushion \(.*han_2005.*\) and ball \(.*\); got cushion: rubber|got cloth"):
        build_gap_scene(read_track_folders([with_laws(tmp_path / "odd", laws=laws)]))
