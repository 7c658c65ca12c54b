"""Batches find clips by content, run them in processes that may die, summarize and resume."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from PIL import Image
from rich.console import Console
from support.pseudo_terminal import Terminal, make_terminal

from models.core.errors import ClipError, OptionError
from pipeline.batch import clip_discovery, clip_runner, supervision
from pipeline.batch.clip_discovery import (
    FilmLength,
    assign_folders,
    describe_room,
    estimate_bytes,
    order_largest_first,
    survey_folder,
)
from pipeline.batch.clip_job import ClipJob, ClipLimits, ClipResult
from pipeline.batch.dask_cluster import hash_code, require_usable_answer
from pipeline.batch.run_batch import format_csv, render_index_page, write_summary
from pipeline.batch.supervision import SupervisedProcess
from pipeline.chain import default_run_folder, make_change_check
from pipeline.cli.commands.batch_command import BatchDisplay, RemainingTime
from pipeline.engine.atomic_write import machine_id, remove_leftovers, replace_file
from pipeline.engine.result_cache import CacheKey, CacheMissing, ResultCache
from pipeline.run_options import RunOptions, list_setting_values
from video.io.clip import open_clip, read_frames
from video.io.clip_digest import compute_clip_digest

ROOT = Path(__file__).resolve().parents[3]
HANG_S = 600
"""Time after which a process hangs, s."""
trueroll = pytest.fixture(make_terminal)


def write_video(path: Path, count: int = 12, suffix: str = "") -> Path:
    """Write a grey video without a table; `suffix` decides the container, whatever the name."""
    form = {".mkv": "matroska", ".avi": "avi", ".mov": "mov", ".webm": "webm"}.get(suffix, "mp4")
    codec = {"webm": "libvpx", "avi": "mpeg4"}.get(form, "libx264")
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w", format=form) as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for k in range(count):
            frame = av.VideoFrame.from_ndarray(np.full((64, 96, 3), 10 * k % 251, np.uint8))
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_images(folder: Path, numbers: list[int]) -> Path:
    folder.mkdir(parents=True)
    for k in numbers:
        Image.fromarray(np.full((64, 96, 3), 7 * k % 251, np.uint8)).save(folder / f"shot {k}.png")
    return folder


@pytest.fixture
def job(tmp_path: Path) -> ClipJob:
    cache = ResultCache(tmp_path / "cache")
    clip, out = write_video(tmp_path / "in" / "a.mp4"), tmp_path / "out" / "a"
    return ClipJob(str(clip), "a.mp4", str(out), str(cache.root), cache.mark, list_setting_values(RunOptions()))


def test_clips_are_found_by_content_at_any_depth_whatever_their_names(tmp_path: Path) -> None:
    names = ["a.mp4", "-r.mkv", "Über den Tisch.mov", "🎱.webm", "x" * 240 + ".avi", "deep/er/film", "picture.png"]
    for name in names:
        write_video(tmp_path / name, suffix=Path(name).suffix)
    write_images(tmp_path / "row", list(range(20)))
    for name, content in (("notes.txt", b"no film"), ("sound.m4a", b"\0\0\0\x18ftypM4A "), (".hidden.mp4", b"x")):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "link.mp4").symlink_to(tmp_path / "a.mp4")
    (tmp_path / "loop").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(tmp_path / "pipe.mp4")
    paths = {str(path.relative_to(tmp_path)) for path in survey_folder(tmp_path).clips}
    assert paths == {*names, "row"}


def test_cameras_containers_are_clips_and_their_small_copies_are_left_out(tmp_path: Path) -> None:
    large, small = write_video(tmp_path / "GX010001.MP4"), tmp_path / "GL010001.LRV"
    with av.open(str(small), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 48, 32, "yuv420p"
        for _ in range(12):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 48, 3), np.uint8))))
        container.mux(stream.encode(None))
    shutil.copy(small, tmp_path / "other.LRV")
    with av.open(str(large)) as source, av.open(str(tmp_path / "pi.h264"), "w", format="h264") as raw:
        target = raw.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = target
                raw.mux(packet)
    (tmp_path / "notes.txt").write_text("no film")
    content = survey_folder(tmp_path)
    assert [path.name for path in content.clips] == ["GX010001.MP4", "other.LRV", "pi.h264"]
    assert {one.path.name: one.original for one in content.left_out} == {"GL010001.LRV": large, "notes.txt": None}


def test_folders_of_results_never_meet_and_never_leave_the_output(tmp_path: Path) -> None:
    names = ["a.mp4", "a.mov", "a_mp4.mp4", "A.mkv", "summary.csv.mp4", "sub/tracks.csv.mp4", "sub/a.mp4"]
    clips = [tmp_path / name for name in names]
    places = assign_folders(clips, tmp_path, Path("out"))
    lowered = [str(place).lower() for place in places.values()]
    assert len(set(lowered)) == len(clips)
    assert not {"out/summary.csv", "out/sub/tracks.csv"} & set(lowered)
    assert all(Path(os.path.normpath(place)).is_relative_to("out") for place in places.values())
    assert default_run_folder(Path("...mp4")) == Path("out/clip")


def test_numbered_images_are_a_clip_whose_times_are_the_numbers(tmp_path: Path) -> None:
    row = write_images(tmp_path / "row", [3, 4, 5, 7, 8, 9, 10])
    clip = open_clip(row)
    assert clip.t == pytest.approx([0, 0.04, 0.08, 0.16, 0.2, 0.24, 0.28])
    shades = [int(image[0, 0, 0]) for _, image in read_frames(clip, indices=np.arange(7))]
    assert shades == [7 * k for k in (3, 4, 5, 7, 8, 9, 10)]
    before = compute_clip_digest(row)
    (row / "shot 4.png").write_bytes((row / "shot 5.png").read_bytes())
    assert compute_clip_digest(row) != before
    with pytest.raises(ClipError, match="is a folder"):
        open_clip(tmp_path)


def test_a_job_and_a_row_are_one_line_of_text_and_back(job: ClipJob) -> None:
    assert ClipJob.from_json(job.to_json()) == job
    assert "\n" not in job.to_json()
    assert job.options == RunOptions()
    row = ClipResult("a\udcff.mp4", "done", "green", 3, 1.5, "out/a", "", seconds=2.0)
    assert ClipResult.from_json(row.to_json()) == row


def test_a_bad_clip_is_a_failed_row_and_the_process_takes_the_next_until_its_parent_is_gone(job: ClipJob) -> None:
    with SupervisedProcess() as process:
        first = process.run(job, lambda message: None)
        again = process.run(replace(job, clip=job.clip + ".gone"), lambda message: None)
        assert process._child is not None
        process._child.process.stdin.close()  # type: ignore[union-attr]
        psutil.Process(process._child.process.pid).wait(HANG_S)
    assert (first.status, first.tries) == ("failed", 1)
    assert "no cloth" in first.sentence
    assert first.peak_mb > 20
    assert "does not exist" in again.sentence
    assert not Path(job.folder).exists()


HANGING = """
print('{"ready": true}', flush=True)
input()
print('{"stage": "read", "share": 0.0}', flush=True)
input()
"""
"""A process that begins a clip and never ends it."""


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[SupervisedProcess]:
    monkeypatch.setattr(clip_runner, "build_command", lambda: [sys.executable, "-c", HANGING])
    with SupervisedProcess() as process:
        yield process


@pytest.mark.parametrize(
    ("limits", "wanted"),
    [(ClipLimits(seconds=1e-3), "--time-limit"), (ClipLimits(megabytes=1.0), "--memory-limit")],
)
def test_a_clip_beyond_a_limit_is_stopped_with_a_sentence(
    job: ClipJob, hanging: SupervisedProcess, limits: ClipLimits, wanted: str
) -> None:
    row = hanging.run(replace(job, limits=limits), lambda message: None)
    assert (row.status, row.tries) == ("failed", 1)
    assert wanted in row.sentence


def test_a_process_that_is_killed_is_tried_again_and_not_for_ever(job: ClipJob, hanging: SupervisedProcess) -> None:
    def kill(_: Any) -> None:
        """Kill the process of the clip, and no other child of this one, such as a tracker of shared memory."""
        assert hanging._child is not None
        hanging._child.process.send_signal(signal.SIGKILL)

    row = hanging.run(job, kill)
    assert (row.status, row.tries) == ("failed", 3)
    assert "SIGKILL" in row.sentence


LATE = """
import atexit
atexit.register(lambda: open("farewell", "w").close())
"""
"""An exit handler, as libraries register them."""


def test_a_process_without_a_clip_leaves_without_farewells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text(LATE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with subprocess.Popen(clip_runner.build_command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert b"ready" in process.stdout.readline()
        process.terminate()
        assert process.wait(HANG_S) == 128 + signal.SIGTERM
    assert not (tmp_path / "farewell").exists()


SLOW_TO_LEAVE = """
import pathlib, signal, sys, time

def leave(number, frame):
    with open(f"asked {sys.argv[1]}", "a") as file:
        file.write("once ")
    while len(list(pathlib.Path().glob("asked *"))) < 2:
        time.sleep(0.01)
    sys.exit()

signal.signal(signal.SIGTERM, leave)
open(f"stands {sys.argv[1]}", "w").close()
while True:
    time.sleep(1)
"""
"""Exits when the other process was asked to exit too."""


def test_processes_are_asked_to_exit_together_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for k in range(2):
        monkeypatch.setattr(clip_runner, "build_command", lambda k=k: [sys.executable, "-c", SLOW_TO_LEAVE, str(k)])
        supervision._PROCESSES.append(SupervisedProcess())
        supervision._PROCESSES[-1].start()
    while len(list(tmp_path.glob("stands *"))) < 2:
        time.sleep(0.01)
    children = [one._child.process for one in supervision._PROCESSES if one._child is not None]
    supervision.end_processes()
    assert [child.returncode for child in children] == [0, 0]
    assert [path.read_text() for path in tmp_path.glob("asked *")] == ["once ", "once "]


def test_workers_take_the_largest_clips_first_and_copies_last(tmp_path: Path) -> None:
    small, large = write_video(tmp_path / "a.mp4", count=3), write_video(tmp_path / "b.mp4", count=90)
    row, gone = write_images(tmp_path / "row", list(range(60))), tmp_path / "gone.mp4"
    assert sum(path.stat().st_size for path in row.iterdir()) > large.stat().st_size
    copy = shutil.copy(large, tmp_path / "copy.mp4")
    assert order_largest_first([gone, copy, small, large, row]) == [row, large, small, gone, copy]


def test_a_clip_that_changes_while_it_is_read_is_noticed_and_a_touched_one_is_not(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "a.mp4")
    digest, check = compute_clip_digest(clip), make_change_check(clip)
    os.utime(clip, (1, 1))
    check(digest)
    write_video(clip, count=13)
    with pytest.raises(ClipError, match="was changed"):
        check(digest)


def test_a_cache_that_was_exchanged_is_lost_and_not_made_anew(tmp_path: Path) -> None:
    root = tmp_path / "cache"
    cache = ResultCache(root)
    assert ResultCache(root, mark=cache.mark).mark == ResultCache(root).mark == cache.mark
    root.rename(tmp_path / "elsewhere")
    with pytest.raises(CacheMissing):
        cache.find_or_build(CacheKey("fit", {}), lambda folder: None)
    assert not root.exists()
    ResultCache(root)
    with pytest.raises(CacheMissing, match="another"):
        ResultCache(root, mark=cache.mark)


@pytest.mark.parametrize("name", ["/dev/zero", "../../../secret", "link"])
def test_an_entry_that_others_wrote_cannot_lead_out_of_its_folder(tmp_path: Path, name: str) -> None:
    cache, key = ResultCache(tmp_path / "cache"), CacheKey("fit", {})
    entry = cache.find_or_build(key, lambda folder: (folder / "a").write_text("a") and None)
    (tmp_path / "cache" / "secret").touch()
    (entry.folder / "link").symlink_to("/dev/zero")
    document = json.loads((entry.folder / "manifest.json").read_text())
    document["files"] = {
        name: {"sha256": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855", "size": 0}
    }
    (entry.folder / "manifest.json").write_text(json.dumps(document))
    assert cache.find(key) is None


def test_what_a_dead_process_of_this_machine_left_goes_at_once(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left, living = (tmp_path / f".a.{machine_id()}-{number}.part" for number in (dead.pid, os.getppid()))
    foreign = tmp_path / f".a.0123abcd-{dead.pid}.part"
    for path in (left, living, foreign):
        path.touch()
    remove_leftovers(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {living.name, foreign.name}
    with replace_file(tmp_path / "a") as fresh:
        fresh.touch()
    assert (tmp_path / "a").exists()


DYING_CALLER = """
import os, sys
from pathlib import Path
from pipeline.batch.clip_discovery import FilmLength, describe_room, estimate_bytes
from pipeline.batch.dask_cluster import require_usable_workers
from pipeline.engine.result_cache import ResultCache

class Client:
    def wait_for_workers(self, *_, **__): pass
    def nthreads(self): return {"tcp://here": 1}
    def run(self, function, *words, **_):
        function(*words)
        os._exit(9)

root = Path(sys.argv[1])
require_usable_workers(Client(), ResultCache(root / "cache"), root / "out", root)
"""


def test_what_a_caller_left_that_was_killed_while_it_asked_its_workers_goes_at_once(tmp_path: Path) -> None:
    died = subprocess.run([sys.executable, "-c", DYING_CALLER, str(tmp_path)], check=False)
    out, building = tmp_path / "out", tmp_path / "cache" / "building"
    assert died.returncode == 9
    assert len(list(out.iterdir())) == len(list(building.iterdir())) == 1
    remove_leftovers(out)
    ResultCache(tmp_path / "cache").remove_leftovers()
    assert [*out.iterdir(), *building.iterdir()] == []


def build_results() -> list[ClipResult]:
    return [
        ClipResult("b <script>alert(1)</script>\udcff\n.mp4", "done", "green", 3, 1.5, "out/b\udcff", "", seconds=3.0),
        ClipResult("a.mp4", "failed", "", 0, 0.0, "", 'no "table", no clip', seconds=1.0, shots=0),
    ]


def test_the_summary_is_ordered_escaped_and_equal_for_equal_results(tmp_path: Path) -> None:
    write_summary(build_results(), tmp_path)
    text = (tmp_path / "summary.csv").read_text(encoding="utf-8")
    slower = [replace(row, seconds=99.0, tries=2) for row in reversed(build_results())]
    write_summary(slower, tmp_path)
    assert (tmp_path / "summary.csv").read_text(encoding="utf-8") == text
    lines = list(csv.DictReader(text.splitlines()))
    assert [line["status"] for line in lines] == ["failed", "done"]
    page = (tmp_path / "summary.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in page
    assert "default-src 'none'" in page
    assert pq.read_table(tmp_path / "summary.parquet").column("seconds").to_pylist() == [99.0, 99.0]
    assert format_csv([]).startswith("clip,status,trust,contacts,seconds_in,folder,sentence")
    assert "%FF" in render_index_page(build_results(), tmp_path)


def test_the_time_left_follows_from_the_work_that_did_not_come_from_the_cache() -> None:
    remaining = RemainingTime(0.0)
    assert remaining.describe(0.0, 20.0) == "", "the search for shots is no share of them"
    assert remaining.describe(0.5, 20.1) == "", "half of it is cached"
    assert remaining.describe(0.6, 80.1) == "about 4 min left"
    assert remaining.describe(0.8, 140.1) == "about 80 s left"


def test_what_will_be_written_is_said_and_refused_where_even_half_of_it_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = RunOptions().render
    films = [FilmLength(tmp_path / name, 1280 * 720, 110) for name in ("a", "b")]
    need = estimate_bytes(films, options)
    assert need > 2 * estimate_bytes(films, replace(options, no_video=True))
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "slow.mp4").touch()
    assert estimate_bytes(films, options) == need / 2, "the first is there already"
    usage = shutil.disk_usage(tmp_path)
    for share, expected in ((3.0, r"are free$"), (1.5, "which may not do")):
        monkeypatch.setattr(shutil, "disk_usage", lambda _, free=share * need: usage._replace(free=int(free)))
        assert re.search(expected, describe_room(need, tmp_path / "new" / "out", tmp_path))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=int(0.9 * need)))
    with pytest.raises(OptionError, match="free some, or use --no-video"):
        describe_room(need, tmp_path, tmp_path)


class FakeClock:
    """A clock for `watch_folder` that goes on by a tenth of a second whenever it is read."""

    def __init__(self, listener: Callable[[], None] = lambda: None) -> None:
        self.now = 0.0
        self._listener = listener

    def monotonic(self) -> float:
        self._listener()
        self.now += 0.1
        return self.now


def test_a_watched_folder_gives_clips_once_they_rest_and_again_when_they_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_discovery, "time", clock := FakeClock())
    write_video(tmp_path / "early.mp4")
    late, changes, delivered = tmp_path / "late.mp4", [2.0, 4.0], []
    for path in clip_discovery.watch_folder(tmp_path, tmp_path / "out", 6.0):
        if path is not None:
            delivered.append((path.name, clock.now))
            changes += [clock.now + 2.0] * (len(delivered) == 2)
        elif changes and clock.now >= changes[0]:
            write_video(late, count=12 + int(clock.now))
            changed = changes.pop(0)
    assert [name for name, _ in delivered] == ["early.mp4", "late.mp4", "late.mp4"]
    rests = [delivered[0][1], delivered[1][1] - 4.0, delivered[2][1] - changed]
    assert all(
        clip_discovery.SETTLE_S <= rest < clip_discovery.SETTLE_S + 3 * clip_discovery.POLL_INTERVAL_S for rest in rests
    )
    assert clock.now - delivered[2][1] == pytest.approx(6.0, abs=2 * clip_discovery.POLL_INTERVAL_S)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask scheduler with two workers, on loopback, in processes of their own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    dask = [sys.executable, "-m", "dask"]
    worker = [*dask, "worker", address, "--nthreads", "1", "--nworkers", "2", "--no-dashboard", "--host", "127.0.0.1"]
    commands = [[*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"], worker]
    clip_processes = [
        subprocess.Popen(c, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for c in commands
    ]
    yield address
    for process in reversed(clip_processes):
        process.terminate()
        process.wait(HANG_S)


def run_batch_command(folder: Path, *arguments: str, prepare: str = "pass") -> tuple[int, dict[str, str], str]:
    """Run `trueroll batch` after some code; return its status, the sentence of each clip, and standard error."""
    program = f"from pipeline.cli.main import main; {prepare}; main()"
    command = [sys.executable, "-c", program, "batch", "in", "-o", "out", "--json"]
    done = subprocess.run(
        [*command, "--cache", "cache", *arguments], cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=HANG_S, check=False,
    )  # fmt: skip
    rows = json.loads(done.stdout) if done.stdout else []
    return done.returncode, {row["clip"]: row["sentence"] for row in rows}, done.stderr


@pytest.mark.slow
def test_one_process_several_and_a_cluster_give_the_same_results(tmp_path: Path, scheduler: str) -> None:
    for name in ("a.mp4", "deep/b.mkv", "-c.mov"):
        write_video(tmp_path / "in" / name, suffix=Path(name).suffix)
    for odd in (b"\xff.mp4", b"\xfe.mp4"):
        shutil.copy(tmp_path / "in" / "a.mp4", Path(os.fsdecode(os.fsencode(tmp_path / "in") + b"/" + odd)))
    (tmp_path / "in" / "broken.mp4").write_text("no film")
    results = [run_batch_command(tmp_path, *arguments) for arguments in ((), ("--jobs", "2"), ("--cluster", scheduler))]
    assert [(status, err) for status, _, err in results] == [(1, "")] * 3
    assert results[0][1] == results[1][1] == results[2][1]
    assert set(results[0][1]) == {"a.mp4", "deep/b.mkv", "-c.mov", "broken.mp4", "\ufffd.mp4", "\ufffd.mp4\u2032"}
    assert not list((tmp_path / "cache" / "building").iterdir())


def test_a_cluster_that_is_not_there_or_does_not_share_is_refused_before_the_work(tmp_path: Path) -> None:
    write_video(tmp_path / "in" / "a.mp4")
    hasten = "from pipeline.batch import dask_cluster; dask_cluster.CONNECT_TIMEOUT_S = 0.5"
    status, _, err = run_batch_command(tmp_path, "--cluster", "tcp://127.0.0.1:9", prepare=hasten)
    assert status == 2
    assert "none answers" in err
    assert err.count("\n") == 1
    cache = ResultCache(tmp_path / "cache")
    answer = {"code": hash_code(), "mark": "another", "out": True, "clip": 1}
    for place, wanted in (
        ({}, "does not share the cache"),
        ({"code": ""}, "another version"),
        (OSError("x"), "cannot run"),
    ):
        with pytest.raises(OptionError, match=wanted):
            require_usable_answer(
                "tcp://w", answer | place if isinstance(place, dict) else place, cache, "p", tmp_path, tmp_path
            )


def test_processes_share_the_clips_of_a_batch_and_a_pause_ends_nothing(job: ClipJob) -> None:
    jobs = iter([replace(job, name="a"), None, replace(job, name="b"), replace(job, name="c")])
    results = list(supervision.run_on_processes(2, jobs, lambda name, message: None))
    assert {one.clip for one in results} == {"a", "b", "c"}
    assert not supervision._PROCESSES


@pytest.mark.parametrize("ends", ["when nothing comes", "with an interruption"])
def test_a_watched_batch_runs_what_comes_and_lists_the_results(
    ends: str, trueroll: Terminal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt() -> None:
        if ends == "with an interruption" and (tmp_path / "out" / "summary.csv").exists():
            raise KeyboardInterrupt

    answer = json.dumps({"row": ClipResult("a.mp4", "failed", "", 0, 0.0, "", "no cloth", seconds=1.0).to_json()})
    program = f"print('{{\"ready\": true}}', flush=True); input(); print({answer!r}, flush=True); input()"
    monkeypatch.setattr(clip_runner, "build_command", lambda: [sys.executable, "-c", program])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(clip_discovery, "time", FakeClock(interrupt))
    monkeypatch.setattr("pipeline.batch.supervision.IDLE_S", 0.0)
    write_video(tmp_path / "in" / "a.mp4")
    idle = ["--idle", 6] * (ends == "when nothing comes")
    done = trueroll("batch", "in", "-o", "out", "--cache", "cache", "--watch", *idle, "--json")
    assert (done.status, done.err) == (1, "")
    assert [(row["clip"], row["status"]) for row in json.loads(done.out)] == [("a.mp4", "failed")]


def start_interruptible_batch(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a batch that reacts to Ctrl-C even where the tests run in the background."""
    program = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    command = [sys.executable, "-c", f"{program}from pipeline.cli.main import main; main()", "batch", "in", "-o", "out"]
    return subprocess.Popen(
        [*command, "--cache", "cache", *arguments], cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for(happened: Callable[[], object]) -> None:
    end = time.monotonic() + HANG_S
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("arguments", [(), ("--jobs", "2")])
def test_an_interrupted_batch_leaves_no_process_and_nothing_half_written(
    tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    for k in range(4):
        write_video(tmp_path / "in" / f"{k}.mp4", count=30 + k)
    process = start_interruptible_batch(tmp_path, *arguments)
    wait_for(psutil.Process(process.pid).children)
    family = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert err.startswith("Disk: about ")
    assert err.endswith("are free\ntrueroll: interrupted; nothing half-written is left\n")
    assert not psutil.wait_procs(family, timeout=60)[1]
    assert not list(tmp_path.rglob("*.part*"))


def test_the_display_shows_all_clips_in_one_line_and_each_that_runs() -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=120)
    with BatchDisplay(console, 2) as display:
        display.show_progress("a [bold]" + "x" * 50, {"stage": "detect", "share": 0.4})
        display.show_progress("b.mp4", {"shot": [2, 17], "done": 0.1})
        display.show_progress("b.mp4", {"note": "much room"})
        display.show_result(build_results()[1], 2)
        display._bars.refresh()
    text = output.getvalue()
    assert "detect" in text
    assert "shot 2 of 17" in text
    assert "much room" in text
    assert "1/2" in text
    assert "1 failed" in text
    with BatchDisplay(Console(file=output), None) as silent:
        length = len(output.getvalue())
        silent.show_progress("a", {"stage": "detect", "share": 0.4})
        silent.show_result(build_results()[0], 1)
    assert len(output.getvalue()) == length
