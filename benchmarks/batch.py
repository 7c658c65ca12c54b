"""What a batch brings and costs: two workers against one, 200 clips with bad ones among them, a warm rerun, memory, and
the cost of each stage against decoding the clip once and encoding its slow motion once.

    python benchmarks/batch.py [--clips 200] [--pace 100] [--only workers many cost] [--cost-clips CLIP...]
        [--times 3]

Prints the lines of a table of goals, and a table of stages. Pace is measured in clips per minute of wall-clock time, on
one processor per worker, and says something on an idle machine only; the load of the machine, the CPU seconds per clip
and what two copies of a loop that share nothing bring on it are printed beside it. A worker takes two to three seconds
to start, so a few clips do not tell. Costs are CPU seconds, of clips that find the code compiled, each time against
what it is compared with in the same process; the middle one of several times is told, for a shared machine is now
faster, now slower.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction
from multiprocessing import get_context
from pathlib import Path

from pipeline.engine.process_setup import spare_collections, spare_threads

spare_threads()  # as the program does, before numpy is there
spare_collections()

import av  # noqa: E402
import numpy as np  # noqa: E402
import psutil  # noqa: E402
from fault_runs import ROOT, Place  # noqa: E402
from machine import Ceiling  # noqa: E402
from small_clips import SAMPLES, write_clips, write_small  # noqa: E402

BAD_SHARE = 0.05
DISTINCT = 8
"""Clips of different content; the others are copies under other names, whose pages and recordings are made anew."""
Line = tuple[str, str, str, bool]


def workers(folder: Path, pace: int) -> Line:
    """Clips per minute by one worker and by two, one processor each, in turns; and between them what the machine bears.

    Two processors of a machine are seldom twice one: copies of a loop that share nothing are run before and after each
    batch, as many as it has workers.
    """
    write_clips(folder / "clips", pace)
    load, mine = os.getloadavg()[0], os.sched_getaffinity(0)
    seconds: dict[int, list[float]] = {1: [], 2: []}
    spent: dict[int, list[float]] = {1: [], 2: []}
    ceiling = Ceiling()
    for jobs in (1, 2, 2, 1):
        ceiling.measure(jobs)
        place = Place(folder, f"jobs-{jobs}-{len(seconds[jobs])}")
        began, before = time.monotonic(), _children()
        # a worker draws, decodes and encodes on threads of its own: without this one worker takes two processors
        os.sched_setaffinity(0, sorted(mine)[:jobs])
        status, _, err = place.run("--jobs", str(jobs))
        os.sched_setaffinity(0, mine)
        seconds[jobs].append(time.monotonic() - began)
        spent[jobs].append((_children() - before) / pace)
        if status:
            raise SystemExit(f"the batch failed: {err}")
        shutil.rmtree(folder / place.name)
        ceiling.measure(jobs)
    one, two = (60 * pace / min(seconds[jobs]) for jobs in (1, 2))
    bears = ", ".join(f"{name} {times:.2f}x" for name, times in ceiling.times().items())
    told = (
        f"{two / one:.2f}x ({one:.1f} and {two:.1f} clips per minute, "
        f"{min(spent[1]):.2f} and {min(spent[2]):.2f} CPU s a clip; two copies of a loop: {bears}: "
        f"{100 * two / one / max(ceiling.times().values()):.0f} % of the best; load {load:.1f} on {len(mine)} cores)"
    )
    return ("two workers against one", ">= 1.8x", told, two / one >= 1.8)


def _children() -> float:
    """CPU seconds of all processes that were started here and have ended."""
    now = os.times()
    return now.children_user + now.children_system


def many(folder: Path, count: int) -> list[Line]:
    """A folder of good clips with bad ones among them, cold and once more."""
    place, bad = Place(folder, "many"), round(BAD_SHARE * count)
    distinct = write_clips(folder / "distinct", DISTINCT)
    place.clips.mkdir()
    for k in range(count - bad):
        shutil.copy(distinct[k % DISTINCT], place.clips / f"{k:04d}.mp4")
    for k in range(bad):
        data = distinct[k % DISTINCT].read_bytes()
        (place.clips / f"bad {k:03d}.mp4").write_bytes(data[: len(data) // (k + 2)] if k % 2 else os.urandom(4000))
    cold, memory = _followed(place)
    rows = _rows(place)
    done = [row for row in rows if row["status"] == "done"]
    first = {name: (place.out / "0000" / name).read_bytes() for name in ("tracks.csv", "events.csv")}
    same = all(first[name] == (place.out / f"{k:04d}" / name).read_bytes()
               for k in range(0, count - bad, DISTINCT) for name in first)  # fmt: skip
    warm, _ = _followed(place)
    good = cold.status == warm.status == 1 and len(done) == count - bad and same and len(rows) == count
    sentences = all(row["sentence"] for row in rows if row["status"] == "failed")
    early, late = memory[len(memory) // 10], memory[9 * len(memory) // 10]
    return [
        (f"{count} clips, {bad} of them bad", "exit 1, every good one done and equal, a sentence for each bad one",
         f"exit {cold.status}, {len(done)} done, {len(rows) - len(done)} failed, copies "
         f"{'equal' if same else 'differ'}; {cold.seconds:.0f} s", good and sentences),
        (f"warm rerun of {count} clips", "<= 10 s", f"{warm.seconds:.1f} s, {warm.cpu:.1f} CPU s", warm.seconds <= 10),
        ("main process from a tenth of the time to nine tenths", "no growth",
         f"{late - early:+.1f} MB at {late:.0f} MB", late - early < 2),
    ]  # fmt: skip


@dataclass(frozen=True)
class Followed:
    status: int
    seconds: float
    cpu: float


def _followed(place: Place) -> tuple[Followed, list[float]]:
    """A batch, and the resident memory (MB) of its main process each time that a clip is done."""
    began, before = time.monotonic(), _children()
    process = place.start()
    seen: list[float] = []

    def follow() -> None:
        main = psutil.Process(process.pid)
        while process.poll() is None:
            with _gone():
                seen.append(main.memory_info().rss / 1e6)
            time.sleep(0.2)

    follower = threading.Thread(target=follow)
    follower.start()
    process.communicate()
    follower.join()
    return Followed(process.returncode, time.monotonic() - began, _children() - before), seen[:-1] or [0.0]


class _gone:
    """A process that has just ended is no fault."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> bool:
        return kind is not None and issubclass(kind, psutil.Error)


def _rows(place: Place) -> list[dict[str, str]]:
    with (place.out / "summary.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@dataclass
class Stopwatch:
    """A watcher that notes the CPU seconds of each stage."""

    cost: dict[str, float] = field(default_factory=dict)
    begun: float = 0.0

    def started(self, stage: str) -> Callable[[float], None]:
        self.begun = time.process_time()
        return lambda share: None

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        self.cost[stage] = time.process_time() - self.begun


@dataclass(frozen=True)
class Cost:
    """CPU seconds of one clip, and MB."""

    chain: float
    """of a fresh process: what that pays once, for all that it imports, is part of it."""
    following: float
    """of the next clip of the process."""
    decode: float
    encode: float
    stages: dict[str, float]
    kept: float
    given: float

    @property
    def least(self) -> float:
        return self.decode + self.encode

    @property
    def times(self) -> float:
        return self.chain / self.least


def cost(folder: Path, clip: Path) -> Cost:
    """The chain, and decoding once and encoding its slow motion once, in this process, a fresh one."""
    sys.path.insert(0, str(ROOT))  # before the scripts here, one of which is called as a package is
    from pipeline.chain import run_clip
    from pipeline.engine.result_cache import Cache
    from pipeline.options import RunOptions
    from video.calibration.shot_cuts import find_shots
    from video.io.clip import open_clip

    watch, out = Stopwatch(), folder / f"out {clip.stem}"
    whole = _cpu(lambda: run_clip(clip, out, RunOptions(), Cache(folder / f"cache {clip.stem}"), watch) and None)
    places = folder / f"next {clip.stem}", Cache(folder / f"next cache {clip.stem}")
    following = _cpu(lambda: run_clip(clip, places[0], RunOptions(), places[1], Stopwatch()) and None)
    decode = _cpu(lambda: _decode(clip))
    encode = _mean(lambda: _encode(out / "slow.mp4", folder / "again.mp4")) - _mean(lambda: _decode(out / "slow.mp4"))
    watch.cost["(keys and files)"] = whole - sum(watch.cost.values())
    seen = open_clip(clip)
    watch.cost["(shots, of long recordings only)"] = _cpu(lambda: find_shots(seen) and None)
    kept, given = _megabytes(folder / f"cache {clip.stem}"), _megabytes(out)
    return Cost(whole, following, decode, encode, watch.cost, kept, given)


def middle_cost(folder: Path, clip: Path, times: int) -> tuple[Line, list[tuple[str, float, float]]]:
    """The line of a clip, and its stages with their shares, of the middle one of so many fresh processes."""
    found = []
    for k in range(times):
        (folder / f"time {k}").mkdir(exist_ok=True)
        with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
            found.append(fresh.submit(cost, folder / f"time {k}", clip).result())
    found.sort(key=lambda one: one.times)
    one = found[len(found) // 2]
    with av.open(str(clip)) as film:
        stream = film.streams.video[0]
        size, seconds = f"{stream.width} x {stream.height}", float(film.duration or 0) / 1e6
    told = (
        f"{one.times:.1f}x, of {times} times {found[0].times:.1f} to {found[-1].times:.1f} ({one.chain:.1f} against"
        f" {one.decode:.1f} + {one.encode:.1f} CPU s; {one.following / one.least:.1f}x for the next clip of the"
        " process);"
        f" {one.kept:.1f} MB of cache, {one.given:.1f} MB of results"
    )
    stages = [(stage, spent, spent / one.least) for stage, spent in one.stages.items()]
    return (f"chain of {clip.name}, {size}, {seconds:.1f} s", "<= 4x", told, one.times <= 4), stages


def _megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def _cpu(work: Callable[[], None]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _mean(work: Callable[[], None]) -> float:
    """CPU seconds, of two times: a shared machine is now faster, now slower."""
    return (_cpu(work) + _cpu(work)) / 2


def _decode(clip: Path) -> None:
    with av.open(str(clip)) as film:
        film.streams.video[0].thread_type = "AUTO"
        film.streams.video[0].codec_context.thread_count = 2
        for _ in film.decode(video=0):
            pass


def _encode(slow: Path, target: Path) -> None:
    """The pictures of the slow motion once more; what decoding them costs is taken off by the caller."""
    with av.open(str(slow)) as film, av.open(str(target), "w") as again:
        seen = film.streams.video[0]
        seen.thread_type = "AUTO"
        stream = again.add_stream("libx264", rate=seen.average_rate or Fraction(30))
        stream.width, stream.height, stream.pix_fmt = seen.width, seen.height, "yuv420p"
        stream.codec_context.options = {"crf": "20", "preset": "veryfast"}
        stream.codec_context.thread_count = 2
        for k, picture in enumerate(film.decode(seen)):
            picture.pts, picture.time_base = k, 1 / Fraction(stream.codec_context.rate)
            again.mux(stream.encode(picture))
        again.mux(stream.encode(None))


def cost_clips(folder: Path) -> list[Path]:
    """A sample at 720 and at 1080 lines, where no clips are named."""
    return [
        write_small(SAMPLES / "overhead_pool.mp4", folder / f"pool_{lines}p.mp4", height=lines, start=0.0, seconds=9.0)
        for lines in (720, 1080)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=200)
    parser.add_argument("--pace", type=int, default=100)
    parser.add_argument("--only", nargs="+", default=["workers", "many", "cost"])
    parser.add_argument("--cost-clips", nargs="+", type=Path, default=[])
    parser.add_argument("--times", type=int, default=3, help="odd, how often the cost is measured (default 3)")
    given = parser.parse_args()
    lines: list[Line] = []
    stages: dict[str, list[tuple[str, float, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "workers" in given.only:
            lines.append(workers(folder / "pace", given.pace))
        if "many" in given.only:
            (folder / "batch").mkdir()
            lines += many(folder / "batch", given.clips)
        if "cost" in given.only:
            write_clips(folder / "compiled" / "clips", 1)
            Place(folder / "compiled", "once").run()
            for clip in given.cost_clips or cost_clips(folder):
                line, stages[clip.name] = middle_cost(folder, clip, given.times)
                lines.append(line)
    print("| what | goal | found | met |\n|---|---|---|---|")
    for what, goal, found, met in lines:
        print(f"| {what} | {goal} | {found} | {'yes' if met else '**no**'} |")
    for clip_name, found_stages in stages.items():
        print(f"\n| stage of {clip_name} | CPU s | times decode + encode |\n|---|---|---|")
        for stage, spent, share in sorted(found_stages, key=lambda row: -row[1]):
            print(f"| {stage} | {spent:.2f} | {share:.2f} |")
        print(f"| median of stages | {np.median([spent for _, spent, _ in found_stages]):.2f} | |")
    return int(not all(met for *_, met in lines))


if __name__ == "__main__":
    sys.exit(main())
