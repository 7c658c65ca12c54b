"""Tracks of other programs: written and read again, read as those programs write them, or refused in one sentence."""

from __future__ import annotations

import csv
import json
import random
import re
import zipfile
from pathlib import Path

import msgpack
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import pipeline.io.formats
import trueroll
from models.core.errors import OptionError
from pipeline.actions.convert_tracks import ConvertOptions, convert_tracks, find_output_format, read_tracks
from pipeline.cli.execute import execute_command_line
from pipeline.io.formats.track_format import PointTracks, list_formats
from pipeline.io.track_folder import read_track_folders

ENDINGS = {
    "tracker": ".trk", "tracker-text": ".tracker.txt", "mot": ".mot.txt", "coco": ".coco.json",
    "label-studio": ".labelstudio.json", "deeplabcut": ".dlc.csv", "sleap": ".sleap.csv", "parquet": ".parquet",
    "mcap": ".mcap", "track-folder": "", "pooltool": ".pooltool.json", "pooltool packed": ".msgpack",
}  # fmt: skip
COMPARED = ("frame", "t", "x", "y", "x_px", "y_px", "radius_px")


def require_package(ending: str) -> None:
    if ending == ".mcap":
        pytest.importorskip("mcap", reason="the extra simulators is not installed")


def write_source(folder: Path) -> Path:
    """Two balls, 20 frames with gaps, places in m and px."""
    folder.mkdir()
    rows = ["shot,frame,t,id,kind,x,y,x_px,y_px,radius_px"]
    for frame in range(20):
        for ball, (name, kind) in enumerate((("cue", "cue"), ("red-2", "red"))):
            if frame % 7 != ball:
                x, y = 0.2 + 0.03 * frame, 0.3 + 0.01 * frame + 0.2 * ball
                px = f"{400 * x + 8:.3f},{300 - 400 * y:.3f}"
                rows.append(f"0,{frame},{frame / 25:.6f},{name},{kind},{x:.6f},{y:.6f},{px},{10 + ball}")
    (folder / "tracks.csv").write_text("\n".join(rows) + "\n")
    scene = {"scene": "billiards", "fps": 25, "table": {"length": 2.54, "width": 1.27}, "px_per_m": 400}
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def sort_rows(tracks: PointTracks) -> PointTracks:
    order = np.lexsort((tracks.columns["y_px" if "y_px" in tracks.columns else "y"], tracks.columns["frame"]))
    return PointTracks({name: values[order] for name, values in tracks.columns.items()}, tracks.unit)


def export(tmp_path: Path, ending: str) -> Path:
    require_package(ending)
    target = tmp_path / (f"out{ending}" if ending else "out")
    convert_tracks(write_source(tmp_path / "source"), target, ConvertOptions(), None, None)
    return target


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_tracks_are_the_same_after_a_format_and_back(tmp_path: Path, ending: str) -> None:
    target = export(tmp_path, ending)
    read, output = read_tracks(target)
    assert output.name == find_output_format(target).name
    first, second = (sort_rows(one) for one in (read_tracks(tmp_path / "source")[0], read))
    if "y_px" not in read.columns:  # y of the image points down, and the order of rows with it
        first = PointTracks({name: first.columns[name] for name in first.columns if not name.endswith("_px")})
        first, second = sort_rows(first), sort_rows(second)
    shared = [name for name in COMPARED if name in second.columns and name in first.columns]
    assert {"x", "y"} <= set(shared) or {"x_px", "y_px"} <= set(shared)
    for name in shared:
        assert np.allclose(first.columns[name], second.columns[name], atol=1e-6), name
    expected = ["1", "2"] if output.name == "mot" else ["cue", "red-2"]
    assert sorted(read.ids) == expected


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
@pytest.mark.parametrize("names", [('mass A, 1; "x"', "tab\there", "Ünï 🎱", "#1", "nan", "=1+1"), ("1",)])
def test_any_name_and_a_single_row_survive_a_format(tmp_path: Path, ending: str, names: tuple[str, ...]) -> None:
    require_package(ending)
    source = write_source(tmp_path / "source")
    with (source / "tracks.csv").open("w", newline="") as file:
        csv.writer(file).writerows([
            ("frame", "t", "id", "x", "y", "radius_px"),
            *((0, 0.0, name, 0.2 + 0.1 * k, 0.5, 10) for k, name in enumerate(names)),
        ])  # fmt: skip
    target = tmp_path / (f"out{ending}" if ending else "out")
    convert_tracks(source, target, ConvertOptions(), None, None)
    read, expected = read_tracks(target)[0], read_tracks(source)[0]
    assert len(read.columns["id"]) == len(expected.columns["id"])
    if ".mot" not in ending:
        plain = [" ".join(name.split()).replace('"', "'") for name in expected.ids]
        assert [" ".join(name.split()).replace('"', "'") for name in read.ids] == plain


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_every_export_carries_version_source_and_options(tmp_path: Path, ending: str) -> None:
    require_package(ending)
    target = tmp_path / (f"out{ending}" if ending else "out")
    convert_tracks(write_source(tmp_path / "source"), target, ConvertOptions(fps=25.0), None, None)
    if ending == ".parquet":
        text = str(parquet.read_schema(target).metadata)
    else:
        beside = target.with_name(f"{target.name}.source.json")
        file = beside if beside.exists() else target / "scene.json" if target.is_dir() else target
        text = file.read_bytes().decode("latin-1")
        if ending == ".msgpack":
            text = str(msgpack.unpackb(target.read_bytes()))
        if ending == ".mcap":
            from mcap.reader import make_reader

            with target.open("rb") as stream:
                text = " ".join(str(record.metadata) for record in make_reader(stream).iter_metadata())
    assert all(word in text for word in (trueroll.__version__, "source", "fps", "25"))


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_a_malformed_file_is_refused_in_one_sentence(tmp_path: Path, ending: str) -> None:
    """Truncated, empty, binary, huge numbers, changed, repeated and missing parts: 24 files of each format."""
    target = export(tmp_path, ending)
    target = target / "tracks.csv" if target.is_dir() else target
    data, rng, sentences = target.read_bytes(), random.Random(ending), []
    for number in range(24):
        changed = bytearray(data)
        match number % 8:
            case 0:
                changed = changed[: rng.randrange(len(data))]
            case 1:
                changed = bytearray(rng.randbytes(200) if number > 8 else b"")
            case 2:
                changed = bytearray(data.replace(b"0.", b"9e300"))
            case 3:
                for _ in range(4):
                    changed[rng.randrange(len(data))] = rng.randrange(256)
            case 4:
                changed = changed + changed
            case 5:
                start = rng.randrange(len(data))
                del changed[start : start + rng.randrange(1, 60)]
            case 6:
                changed = bytearray(data.replace(b"1", b"x"))
            case 7:
                changed = bytearray(data.replace(b"frame", b"f").replace(b"x", b"q", 20))
        path = tmp_path / f"bad-{number}{ending or '.csv'}"
        path.write_bytes(bytes(changed))
        try:
            read, _ = read_tracks(path)
        except OptionError as error:
            sentences.append(str(error))
        else:
            assert len(read.columns["id"]) > 0
    assert all("\n" not in sentence and str(tmp_path) in sentence for sentence in sentences)
    assert len(sentences) >= 6
    words_of_parsers = "could not|[Ee]xpect(ing|ed )[^;]*:|token|magic|thrift|unpack"
    assert not [one for one in sentences if re.search(words_of_parsers, one)]


@pytest.mark.parametrize("ending", [".tracker.txt", ".mot.txt", ".dlc.csv", ".sleap.csv", ".coco.json", ""])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_text_of_other_programs_is_read_in_any_encoding(tmp_path: Path, ending: str, encoding: str) -> None:
    target = export(tmp_path, ending)
    file = target / "tracks.csv" if target.is_dir() else target
    plain = read_tracks(target)[0]
    file.write_bytes(file.read_text().encode(encoding))
    assert read_tracks(target)[0].columns["frame"].tolist() == plain.columns["frame"].tolist()


@pytest.mark.parametrize(("name", "text", "words"), [
    ("a.dlc.csv", "scorer,s,s\nbodyparts,a,a\ncoords,x,y\n0,1,5,2,5\n", "row 1 has 5 values for 3 columns"),
    ("a.sleap.csv", "track,frame_idx,a.x,a.y\nt,0,1,2\nt,1,1\n", "row 2 has not as many values"),
    ("a.labelstudio.json", '[{"annotations": [{"result": []}]}]', "it has no positions"),
    ("a.coco.json", '{"images": [{"id": 1}], "annotations": [{"image_id": 1}]}', "it lacks 'bbox'"),
])  # fmt: skip
def test_a_row_or_part_that_is_missing_is_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(OptionError, match=words):
        read_tracks(tmp_path / name)


def test_a_format_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "dummy_format.py").write_text(
        "import numpy as np\n"
        "from pipeline.io.formats.track_format import PointTracks, TrackFormat\n"
        "def read(path):\n"
        "    x = np.array([float(word) for word in path.read_text().split()[1:]])\n"
        "    n = len(x)\n"
        "    return PointTracks({'frame': np.arange(n), 'id': np.full(n, 'a'), 'x_px': x, 'y_px': x})\n"
        "def write(tracks, path, provenance):\n"
        "    path.write_text('DUMMY ' + ' '.join(map(str, tracks.columns['x_px'])))\n"
        "FORMAT = TrackFormat('dummy', 'dummy file', ('.dummy',), lambda path, head: head.startswith(b'DUMMY'),"
        " read, write, False)\n"
    )
    monkeypatch.setattr(pipeline.io.formats, "__path__", [*pipeline.io.formats.__path__, str(tmp_path)])
    source, target = tmp_path / "a.dummy", tmp_path / "b.mot.txt"
    source.write_text("DUMMY 1 2 3")
    assert "dummy" in list_formats()
    convert_tracks(source, target, ConvertOptions(size_px=4.0), None, None)
    convert_tracks(target, tmp_path / "c.dummy", ConvertOptions(), None, None)
    assert read_tracks(tmp_path / "c.dummy")[0].columns["x_px"].tolist() == [1.0, 2.0, 3.0]


TRACKER = """<?xml version="1.0" encoding="UTF-8"?>
<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">
 <property name="videoclip" type="object"><object class="org.opensourcephysics.media.core.VideoClip">
  <property name="startframe" type="int">10</property><property name="starttime" type="double">500.0</property>
 </object></property>
 <property name="clipcontrol" type="object"><object class="org.opensourcephysics.media.core.StepperClipControl">
  <property name="delta_t" type="double">40.0</property></object></property>
 <property name="coords" type="object"><object class="org.opensourcephysics.media.core.ImageCoordSystem">
  <property name="framedata" type="array" class="[Lorg.opensourcephysics.media.core.ImageCoordSystem$FrameData;">
   <property name="[0]" type="object"><object class="org.opensourcephysics.media.core.ImageCoordSystem$FrameData">
    <property name="xorigin" type="double">100.0</property><property name="yorigin" type="double">200.0</property>
    <property name="angle" type="double">90.0</property><property name="xscale" type="double">50.0</property>
    <property name="yscale" type="double">50.0</property></object></property></property></object></property>
 <property name="tracks" type="collection" class="java.util.ArrayList">
  <property name="item" type="object"><object class="org.opensourcephysics.cabrillo.tracker.CoordAxes">
   <property name="name" type="string">axes</property></object></property>
  <property name="item" type="object"><object class="org.opensourcephysics.cabrillo.tracker.PointMass">
   <property name="name" type="string">mass A</property>
   <property name="framedata" type="array" class="[Lorg.opensourcephysics.cabrillo.tracker.PointMass$FrameData;">
    <property name="[12]" type="object"><object class="org.opensourcephysics.cabrillo.tracker.PointMass$FrameData">
     <property name="x" type="double">150.0</property><property name="y" type="double">200.0</property>
    </object></property></property></object></property></property>
</object>"""


@pytest.mark.parametrize("packed", [False, True])
def test_a_project_of_tracker_gives_times_and_metres_in_its_axes(tmp_path: Path, packed: bool) -> None:
    """The axes are turned by 90 degrees: what lies to the right in the image lies towards -y."""
    path = tmp_path / ("throw.trz" if packed else "throw.trk")
    if packed:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("throw.trk", TRACKER)
    else:
        path.write_text(TRACKER)
    read, _ = read_tracks(path)
    row = {name: values[0] for name, values in read.columns.items()}
    assert (row["frame"], row["id"], row["t"]) == (12, "mass A", pytest.approx(0.58))
    assert (row["x"], row["y"], read.px_per_m) == (pytest.approx(0.0), pytest.approx(-1.0), 50.0)


FOREIGN = {
    "throw.txt": ("tracker-text", "#multi:\n,mass A,,mass B,\nt,x,y,x,y\n0.0,1.0,2.0,3.0,4.0\n4.0E-2,1.1,,3.1,4.1\n",
                  {"mass A": [(0, 1.0, 2.0)], "mass B": [(0, 3.0, 4.0), (1, 3.1, 4.1)]}),
    "det.txt": ("mot", "1,-1,10,20,4,6,0.9,-1,-1,-1\n1,-1,30,40,4,6,0.8,-1,-1,-1\n2,-1,11,20,4,6,0.9,-1,-1,-1\n",
                {"detection-1": [(0, 11.5, 22.5), (1, 12.5, 22.5)], "detection-2": [(0, 31.5, 42.5)]}),
    "gt.txt": ("mot", "1,7,10,20,4,6,1,1,1\n2,7,11,20,4,6,1,1,0.5\n", {"7": [(0, 11.5, 22.5), (1, 12.5, 22.5)]}),
    "boxes.json": ("coco", json.dumps({
        "images": [{"id": 5, "file_name": "img_0003.png", "width": 64, "height": 48}],
        "annotations": [{"id": 1, "image_id": 5, "category_id": 1, "bbox": [10, 20, 4, 6], "area": 24, "iscrowd": 0}],
        "categories": [{"id": 1, "name": "red"}]}), {"detection-1": [(3, 11.5, 22.5)]}),
    "tasks.json": ("label-studio", json.dumps([{
        "data": {"video": "a.mp4", "width": 200, "height": 100}, "annotations": [{"result": [{
            "id": "r1", "type": "videorectangle", "value": {"framesCount": 9, "labels": ["cue"], "sequence": [
                {"frame": 1, "enabled": True, "rotation": 0, "x": 10, "y": 20, "width": 2, "height": 4, "time": 0.04},
            ]}}]}]}]), {"r1": [(0, 21.5, 21.5)]}),
    "plain.csv": ("deeplabcut", "scorer,s,s,s\nbodyparts,tip,tip,tip\ncoords,x,y,likelihood\n0,1,2,1\n3,,,\n4,5,6,1\n",
                  {"tip": [(0, 1.0, 2.0), (4, 5.0, 6.0)]}),
    "many.csv": ("deeplabcut", "scorer,,,s,s\nindividuals,,,a,a\nbodyparts,,,tip,tip\ncoords,,,x,y\n"
                               "labeled-data,clip,img007.png,1,2\n", {"a/tip": [(7, 1.0, 2.0)]}),
    "nodes.csv": ("sleap", "track,frame_idx,instance.score,head.x,head.y,head.score,tail.x,tail.y,tail.score\n"
                           "m,4,0.9,1,2,0.5,,,\nm,5,0.9,1,2,0.5,3,4,1\n",
                  {"m/head": [(4, 1.0, 2.0), (5, 1.0, 2.0)], "m/tail": [(5, 3.0, 4.0)]}),
}  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_files_of_other_programs_are_recognised_and_read(tmp_path: Path, name: str) -> None:
    expected_format, text, expected = FOREIGN[name]
    (tmp_path / name).write_text(text)
    read, chosen = read_tracks(tmp_path / name)
    assert chosen.name == expected_format
    axes = ("x", "y") if "x" in read.columns else ("x_px", "y_px")
    rows: dict[str, list[tuple[float, ...]]] = {}
    for body, frame, x, y in zip(*(read.columns[one].tolist() for one in ("id", "frame", *axes)), strict=True):
        rows.setdefault(body, []).append((frame, x, y))
    assert rows == expected
    assert bool(read.notes) == any(body.startswith("detection") for body in expected)


def test_units_of_a_header_are_kept_without_a_scene(tmp_path: Path) -> None:
    """Feet were taken for metres, and the error of mm for one of m."""
    (tmp_path / "a.csv").write_text("t,h_ft,sigma\n0,100,1\n0.1,101,1\n")
    read, _ = read_tracks(tmp_path / "a.csv")
    assert (read.unit, read.columns["z"].tolist()) == ("m", pytest.approx([30.48, 30.7848]))
    assert read.columns["sigma"].tolist() == pytest.approx([0.3048, 0.3048])
    convert_tracks(tmp_path / "a.csv", tmp_path / "a", ConvertOptions(scene="flight"), None, None)
    assert json.loads((tmp_path / "a" / "scene.json").read_text())["units"] == "m"
    assert read_track_folders([tmp_path / "a"]).recordings[0].positions[0, 0, 0] == pytest.approx(30.48)


def test_a_system_of_pooltool_is_read_in_our_axes(tmp_path: Path) -> None:
    """pooltool's y runs along the table; msgpack holds arrays as msgpack-numpy packs them."""

    def pack(values: list[float] | list[list[list[float]]]) -> dict[bytes, object]:
        array = np.array(values, float)
        return {b"nd": True, b"type": "<f8", b"kind": b"", b"shape": array.shape, b"data": array.tobytes()}

    linear = {name: {"p1": p1} for name, p1 in (("3", [0, 0, 0.04]), ("12", [1.27, 2.54, 0.04]),
                                                ("9", [0, 2.54, 0.04]), ("18", [0, 0, 0.04]))}  # fmt: skip
    rvw = [[[0.3, 0.6, 0.03], [1.0, 2.0, 0.0], [0.0] * 3], [[0.4, 0.8, 0.03], [1.0, 2.0, 0.0], [0.0] * 3]]
    ball = {"params": {"R": 0.03}, "history": None, "history_cts": [pack(rvw), pack([3, 3]), pack([0.0, 0.1])]}
    document = {"cue": {}, "table": {"cushion_segments": {"linear": linear}}, "balls": {"1": ball}}
    path = tmp_path / "shot.msgpack"
    path.write_bytes(msgpack.packb(document))
    read, _ = read_tracks(path)
    assert read.scene["table"] == {"length": 2.54, "width": 1.27}
    assert read.columns["x"].tolist() == [0.6, 0.8]
    assert read.columns["vy"].tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("ending", "words"), [
    (".mot.txt", "--size"), (".trk", "--px-per-m"), (".dlc.csv", "--px-per-m"), (".msgpack", "needs the table"),
    (".json", "ending of no format"), (".parquet.gz", "ending of no format"),
])  # fmt: skip
def test_what_an_export_lacks_is_named_with_the_option_that_states_it(tmp_path: Path, ending: str, words: str) -> None:
    (tmp_path / "tracks.csv").write_text("frame,t,id,x,y\n0,0,a,1,2\n1,0.1,a,1,3\n")
    options = ConvertOptions(px_per_m=100.0) if ending == ".mot.txt" else ConvertOptions()
    with pytest.raises(OptionError, match=words):
        convert_tracks(tmp_path / "tracks.csv", tmp_path / f"out{ending}", options, None, None)
    assert not (tmp_path / f"out{ending}").exists()


def test_a_missing_package_and_hdf5_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "points.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(OptionError, match="export it from DeepLabCut as CSV"):
        read_tracks(tmp_path / "points.h5")


def test_the_command_turns_a_project_of_tracker_into_a_diagnosable_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "throw.trk").write_text(TRACKER)
    out = tmp_path / "throw"
    arguments = ["convert", str(tmp_path / "throw.trk"), "-o", str(out), "--scene", "flight", "--json"]
    assert execute_command_line(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["from"], printed["to"], printed["positions"]) == ("tracker", "track-folder", 1)
    assert read_track_folders([out]).reference.coordinates == ("x", "y")
    assert execute_command_line(["convert", str(tmp_path / "nothing.trk"), "-o", str(out)]) == 2
    assert "there is no" in capsys.readouterr().err


def test_a_folder_with_other_files_is_not_overwritten(tmp_path: Path) -> None:
    source = write_source(tmp_path / "source")
    with pytest.raises(OptionError, match="names the source"):
        convert_tracks(source, source, ConvertOptions(), None, None)
    other = write_source(tmp_path / "other")
    with pytest.raises(OptionError, match="holds other files"):
        convert_tracks(source, other, ConvertOptions(), None, None)


def test_a_table_of_another_program_is_read_from_parquet(tmp_path: Path) -> None:
    table = pa.table({"particle": [1, 1], "frame": [0, 1], "x": [1.0, 2.0], "y": [3.0, 4.0], "mass": [9.0, 9.0]})
    parquet.write_table(table, tmp_path / "trackpy.parquet")
    answer = trueroll.convert(tmp_path / "trackpy.parquet", out=tmp_path / "out", fps=10.0)
    assert answer.document["bodies"] == ["1"]
    assert "particle is read as id" in answer.notes[0]
    assert (tmp_path / "out" / "tracks.csv").read_text().splitlines()[2] == '0,1,0.1,"1",2,4'
