"""The whole chain on the start of a sample clip writes the files of the contract."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from support.carom_start import SAMPLE, SECONDS, SLOW, Home

from pipeline.chain import find_report_tables, hash_tables, publish_files, write_source
from pipeline.engine.result_cache import CacheEntry, ResultCache
from pipeline.io.run_folder import STAGE_FILES
from pipeline.run_options import RunOptions
from pipeline.terminal.progress_display import COMPILING_NOTE
from video.io.video_writer import VideoWriter

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the tests themselves run in the background
from pipeline.cli.main import main
main()"""
HANG_S = 600
"""Time after which a process hangs, s."""
FILES = {
    "slow.mp4", "tracks.csv", "events.csv", "scene.json", "trajectory.csv",
    "recording.rrd", "report.html", "summary.json", "poster.png", "source.json", "shot",
}  # fmt: skip


def copy_still(source: Path, target: Path, frames: int = 24) -> None:
    """Repeat the first eight frames of a video, before its strike."""
    with av.open(str(source)) as film:
        images = [frame.to_ndarray(format="rgb24") for _, frame in zip(range(8), film.decode(video=0), strict=False)]
        rate = film.streams.video[0].average_rate
    with VideoWriter(target, images[0].shape[1], images[0].shape[0], Fraction(rate)) as writer:
        for k in range(frames):
            writer.write(images[k % len(images)])


def test_the_folder_holds_the_files_of_the_contract_and_no_others(home: Home) -> None:
    assert {path.name for path in home.out.iterdir()} == FILES
    assert not [path for path in home.out.iterdir() if path.stat().st_size == 0]


def test_the_slow_motion_plays_everywhere_and_lasts_as_long_as_requested(home: Home) -> None:
    with av.open(str(home.out / "slow.mp4")) as film:
        (stream,) = film.streams.video
        times = [float(frame.time) for frame in film.decode(stream)]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert stream.width % 2 == stream.height % 2 == 0
        rate = stream.average_rate
    assert Fraction(25) <= rate <= 60
    assert np.diff(times) == pytest.approx(1 / float(rate), abs=1e-3)
    assert times[-1] == pytest.approx(SLOW * SECONDS, abs=0.3)


def test_tracks_have_one_row_per_ball_and_frame_with_an_error_each(home: Home) -> None:
    rows = home.rows("tracks.csv")
    keys = [(row["frame"], row["id"]) for row in rows]
    assert len(set(keys)) == len(keys)
    assert {row["id"] for row in rows} == {"white", "yellow", "red"}
    assert set(home.column("tracks.csv", "observed")) <= {0.0, 1.0}
    assert np.all(home.column("tracks.csv", "sigma") > 0)
    rate = home.scene["fps"]
    assert home.column("tracks.csv", "t") == pytest.approx(home.column("tracks.csv", "frame") / rate, abs=2e-3)


def test_places_in_metres_and_pixels_belong_together(home: Home) -> None:
    scene = home.scene
    matrix = np.array(scene["calibration"]["matrix"])
    x, y, u, v = (home.column("tracks.csv", name) for name in ("x", "y", "x_px", "y_px"))
    projected = np.stack([x, y, np.full_like(x, scene["ball_radius"]), np.ones_like(x)]).T @ matrix.T
    assert projected[:, 0] / projected[:, 2] == pytest.approx(u, abs=0.05)
    assert projected[:, 1] / projected[:, 2] == pytest.approx(v, abs=0.05)
    margin = scene["ball_radius"] - 0.02
    assert np.all((x > margin) & (x < scene["table"]["length"] - margin))
    assert np.all((y > margin) & (y < scene["table"]["width"] - margin))


def test_events_are_those_of_the_sample(home: Home) -> None:
    truth = json.loads(SAMPLE.with_suffix(".truth.json").read_text())
    rows = home.rows("events.csv")
    kinds = [(row["kind"], row["a"], row["b"]) for row in rows if row["kind"] != "rest"]
    assert kinds[:3] == [("strike", "white", ""), ("ball", "white", "yellow"), ("cushion", "white", "bottom")]
    t, sigma = (home.column("events.csv", name) for name in ("t", "t_sigma"))
    wanted = [event["t"] for event in truth["events"]][:3]
    assert t[:3] == pytest.approx(wanted, abs=0.01)
    assert np.all(np.diff(t) >= 0)
    assert np.all(sigma > 0)
    probability = home.column("events.csv", "probability")
    assert np.all((probability > 0) & (probability <= 1))


def test_the_motion_is_sampled_a_thousand_times_a_second(home: Home) -> None:
    rows = home.rows("trajectory.csv")
    for ball in ("white", "yellow", "red"):
        t = np.array([float(row["t"]) for row in rows if row["id"] == ball])
        assert np.diff(t) == pytest.approx(0.001, abs=1e-6)
        assert t[-1] - t[0] > SECONDS - 0.2


def test_the_scene_lists_assumptions_fitted_parameters_and_trust(home: Home) -> None:
    scene = home.scene
    assert scene["table"]["length"] == pytest.approx(2.84, abs=0.01)
    assert scene["calibration"]["plane"] in ("cloth", "noses")
    assert scene["calibration"]["camera_height_sigma"] > 0
    assert all({"value", "sigma", "unit"} <= p.keys() for effect in scene["effects"].values() for p in effect.values())
    assert scene["trust"]["light"] in ("green", "amber", "red")
    assert scene["trust"]["why"]
    assert {"px_per_m", "origin_px", "width_px", "height_px"} <= scene["image"].keys()


def test_the_poster_has_at_least_the_size_of_the_clip(home: Home) -> None:
    with Image.open(home.out / "poster.png") as still:
        assert still.width >= home.scene["image"]["width_px"]


def test_a_second_run_takes_everything_from_the_cache(home: Home, tmp_path: Path) -> None:
    done = home.trueroll("graph", home.clip, "--quick", "--slow", SLOW, "--json")
    assert done.status == 0
    assert {view["state"] for view in json.loads(done.out)} == {"cached"}
    done = home.trueroll("run", home.clip, "-o", tmp_path / "again", "--quick", "--slow", SLOW, "--json")
    assert done.status == 0, done.err
    again, before = (
        {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}
        for out in (tmp_path / "again", home.out)
    )
    assert again == before
    assert json.loads(done.out)["trust"] == home.scene["trust"]


def test_another_speed_of_playing_makes_only_what_is_played_again(home: Home) -> None:
    done = home.trueroll("graph", home.clip, "--quick", "--slow", SLOW + 1, "--json")
    views = {view["stage"]: view for view in json.loads(done.out)}
    assert [name for name, view in views.items() if view["state"] == "stale"] == ["poster", "render"]
    assert views["render"]["why"] == "option slow changed"
    assert views["report"]["state"] == "waiting"


def test_a_full_run_after_a_quick_one_repeats_only_what_differs(home: Home) -> None:
    done = home.trueroll("graph", home.clip, "--slow", SLOW, "--json")
    views = {view["stage"]: view["state"] for view in json.loads(done.out)}
    shared = ("read", "calibrate", "detect", "track", "explain", "export", "background", "poster", "record")
    assert [name for name, state in views.items() if state == "cached"] == list(shared)


def test_without_video_there_is_a_report_but_no_slow_motion(home: Home, tmp_path: Path) -> None:
    done = home.trueroll("run", home.clip, "-o", tmp_path / "bare", "--quick", "--no-video", "--slow", SLOW)
    assert done.status == 0, done.err
    assert {path.name for path in (tmp_path / "bare").iterdir()} == FILES - {"slow.mp4"}
    assert "slow.mp4" not in done.out
    page = (tmp_path / "bare" / "report.html").read_text(encoding="utf-8")
    assert page.count('src="slow.mp4"') == 1


@pytest.mark.slow
def test_a_clip_in_which_nobody_strikes_gets_its_report_of_where_the_balls_lie(tmp_path: Path) -> None:
    still = Home(tmp_path)
    still.clip.parent.mkdir()
    copy_still(SAMPLE, still.clip)
    done = still.trueroll("run", still.clip, "-o", still.out, "--slow", SLOW)
    assert done.status == 0, done.err
    assert "No ball moves in this clip." in done.out
    assert {path.name for path in still.out.iterdir()} == FILES
    assert set(still.column("tracks.csv", "shot")) == {0.0}
    assert still.rows("events.csv") == []


def write_exports(folder: Path, text: str) -> None:
    """Write a saved shot and its tables, all with one text."""
    (folder / "shot").mkdir(parents=True)
    (folder / "shot" / "shot.json").write_text(json.dumps({"arrays": f"{text}.npz"}))
    (folder / "shot" / f"{text}.npz").write_text(text)
    for name in STAGE_FILES["export"]:
        (folder / name).write_text(text)


@pytest.mark.parametrize(("events", "stays"), [("old", True), ("new", False)])
def test_a_slow_motion_of_other_tables_is_removed_before_the_new_one_is_made(
    events: str, stays: bool, tmp_path: Path
) -> None:
    made, folder = tmp_path / "made", tmp_path / "run"
    for place, text in ((made, events), (folder, "old")):
        write_exports(place, text)
    (folder / "slow.mp4").write_text("of the old tables")
    publish_files({"export": CacheEntry(made, "key", "export", "content", 0.0, 0, 0.0)}, folder)
    assert (folder / "slow.mp4").exists() == stays
    assert (folder / "events.csv").read_text() == events
    assert [path.name for path in (folder / "shot").glob("*.npz")] == [f"{events}.npz"]


def test_corrected_tables_leave_the_slow_motion_until_the_next_whole_run(tmp_path: Path) -> None:
    made, folder = tmp_path / "made", tmp_path / "run"
    for place, text in ((made, "new"), (folder, "old")):
        write_exports(place, text)
    (folder / "slow.mp4").write_text("of the old tables")
    entries = {"export": CacheEntry(made, "key", "export", "content", 0.0, 0, 0.0)}
    report_tables = find_report_tables(folder)
    publish_files(entries, folder, keeps_older=True)
    write_source(tmp_path / "clip.mp4", folder, RunOptions(), None, report_tables)
    assert (folder / "slow.mp4").exists()
    assert find_report_tables(folder) != hash_tables(folder) == hash_tables(made)
    publish_files(entries, folder)
    assert not (folder / "slow.mp4").exists()


def list_build_times(cache: Path) -> dict[str, float]:
    """Return how long each entry of a cache took: another time tells that it was made again."""
    return {entry.key: entry.seconds for entry in ResultCache(cache).entries()}


def test_one_bad_clip_stops_no_batch_and_a_second_batch_resumes(
    own_home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    clips = own_home.clip.parent
    (clips / "deeper").mkdir()
    shutil.copy(own_home.clip, clips / "deeper" / "same.mov")
    with av.open(str(clips / "single.mp4"), "w") as film:
        stream = film.add_stream("libx264", rate=25)
        stream.width = stream.height = 320
        frame = av.VideoFrame.from_ndarray(np.zeros((320, 320, 3), np.uint8))
        film.mux(stream.encode(frame))
        film.mux(stream.encode(None))
    (clips / "notes.txt").write_text("no clip")
    build_times = []
    for _ in range(2):
        done = own_home.trueroll("batch", clips, "-o", "many", "--quick", "--slow", SLOW)
        assert done.status == 1, done.err
        notes = set(done.err.splitlines()) - {COMPILING_NOTE}
        assert {note.partition(" about ")[0] for note in notes} == {"Left out: notes.txt: no video", "Disk:"}
        assert "2 of 3 clips done" in done.out
        build_times.append(list_build_times(own_home.cache))
    assert build_times[0] == build_times[1]
    with Path("many/summary.csv").open(newline="") as file:
        rows = {row["clip"]: row for row in csv.DictReader(file)}
    assert {name: row["status"] for name, row in rows.items()} == {
        "deeper/same.mov": "done", "start.mp4": "done", "single.mp4": "failed",
    }  # fmt: skip
    assert "1 distinct frame" in rows["single.mp4"]["sentence"]
    for name in ("deeper/same.mov", "start.mp4"):
        assert {path.name for path in Path(rows[name]["folder"]).iterdir()} == FILES
    left = {path.name for path in Path("many").iterdir()}
    assert left == {"summary.csv", "summary.parquet", "summary.html", "deeper", "start"}


@pytest.mark.parametrize(
    ("number", "status", "words"),
    [
        (signal.SIGINT, 130, "trueroll: interrupted; nothing half-written is left\n"),
        (signal.SIGTERM, 143, ""),
    ],
)
def test_a_run_that_is_stopped_leaves_nothing_half_written(
    own_home: Home, number: int, status: int, words: str
) -> None:
    arguments = ("run", own_home.clip, "-o", own_home.out, "--quick", "--slow", 16, "--cache", own_home.cache)
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"},
    )  # fmt: skip
    building = own_home.cache / "building"
    end = time.monotonic() + HANG_S
    while not any(building.glob("render-*/*")):
        assert time.monotonic() < end, "the slow motion was never begun"
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(number)
    out, err = process.communicate(timeout=HANG_S)
    assert (process.returncode, err) == (status, words)
    assert "is struck" in out, "the answer comes before the slow motion"
    assert {path.name for path in own_home.out.iterdir()} == FILES - {"slow.mp4"}
    assert not list(building.iterdir())
