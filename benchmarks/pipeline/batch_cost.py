"""Measure batches: two workers against one, 200 clips with bad ones among them, a warm rerun, memory, and stage costs.

    python -m benchmarks.pipeline.batch_cost [--clips 200] [--pace 100] [--only workers many cost]
        [--cost-clips CLIP...] [--times 3]

Prints a table of goals and a table of stages. Throughput is measured in clips per minute of wall-clock time on one
processor per worker, and is meaningful on an idle machine only; the load of the machine, the CPU seconds per clip, and
the speed-up of two copies of an independent loop are printed beside it. A worker takes two to three seconds to start,
so a few clips are not enough. Stage costs are CPU seconds of clips for which the code is already compiled, relative to
decoding the clip once and encoding its slow motion once in the same process; the median of several runs is reported,
because the speed of a shared machine varies.
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
from multiprocessing import get_context
from pathlib import Path

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

limit_library_threads()  # as the program does, before numpy is imported
limit_garbage_collection()

import av  # noqa: E402
import numpy as np  # noqa: E402
import psutil  # noqa: E402

from benchmarks.pipeline.fault_runs import BatchFolder  # noqa: E402
from benchmarks.pipeline.small_clips import SAMPLES, write_clips, write_small  # noqa: E402
from benchmarks.pipeline.video_passes import measure_cpu, measure_least_cost  # noqa: E402
from benchmarks.support.machine import MachineCeiling  # noqa: E402

BAD_SHARE = 0.05
# Clips of different content; the others are copies under other names, with pages and recordings of their own.
DISTINCT = 8
Line = tuple[str, str, str, bool]


def compare_workers(folder: Path, pace: int) -> Line:
    """Measure clips per minute of one and of two workers, one processor each, alternately.

    Two processors are seldom twice as fast as one: before and after each batch, as many copies of an independent loop
    are run as the batch has workers.
    """
    write_clips(folder / "clips", pace)
    load, mine = os.getloadavg()[0], os.sched_getaffinity(0)
    seconds: dict[int, list[float]] = {1: [], 2: []}
    spent: dict[int, list[float]] = {1: [], 2: []}
    ceiling = MachineCeiling()
    for jobs in (1, 2, 2, 1):
        ceiling.measure(jobs)
        place = BatchFolder(folder, f"jobs-{jobs}-{len(seconds[jobs])}")
        began, before = time.monotonic(), _children_cpu_seconds()
        # a worker renders, decodes and encodes on several threads: without this, one worker uses two processors
        os.sched_setaffinity(0, sorted(mine)[:jobs])
        status, _, err = place.run("--jobs", str(jobs))
        os.sched_setaffinity(0, mine)
        seconds[jobs].append(time.monotonic() - began)
        spent[jobs].append((_children_cpu_seconds() - before) / pace)
        if status:
            raise SystemExit(f"the batch failed: {err}")
        shutil.rmtree(folder / place.name)
        ceiling.measure(jobs)
    one, two = (60 * pace / min(seconds[jobs]) for jobs in (1, 2))
    bears = ", ".join(f"{name} {times:.2f}x" for name, times in ceiling.speedups().items())
    result = (
        f"{two / one:.2f}x ({one:.1f} and {two:.1f} clips per minute, "
        f"{min(spent[1]):.2f} and {min(spent[2]):.2f} CPU s a clip; two copies of a loop: {bears}: "
        f"{100 * two / one / max(ceiling.speedups().values()):.0f} % of the best; load {load:.1f} on {len(mine)} cores)"
    )
    return ("two workers against one", ">= 1.8x", result, two / one >= 1.8)


def _children_cpu_seconds() -> float:
    """Return the CPU seconds of all child processes that have ended."""
    now = os.times()
    return now.children_user + now.children_system


def run_many(folder: Path, count: int) -> list[Line]:
    """Run a folder of good clips with bad ones among them, cold and once more."""
    place, bad = BatchFolder(folder, "many"), round(BAD_SHARE * count)
    distinct = write_clips(folder / "distinct", DISTINCT)
    place.clips.mkdir()
    for k in range(count - bad):
        shutil.copy(distinct[k % DISTINCT], place.clips / f"{k:04d}.mp4")
    for k in range(bad):
        data = distinct[k % DISTINCT].read_bytes()
        (place.clips / f"bad {k:03d}.mp4").write_bytes(data[: len(data) // (k + 2)] if k % 2 else os.urandom(4000))
    cold, memory = _follow_batch(place)
    rows = _read_summary(place)
    done = [row for row in rows if row["status"] == "done"]
    first = {name: (place.out / "0000" / name).read_bytes() for name in ("tracks.csv", "events.csv")}
    same = all(first[name] == (place.out / f"{k:04d}" / name).read_bytes()
               for k in range(0, count - bad, DISTINCT) for name in first)  # fmt: skip
    warm, _ = _follow_batch(place)
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
class BatchCost:
    """Exit status, wall-clock seconds and CPU seconds of a batch."""

    status: int
    seconds: float
    cpu: float


def _follow_batch(place: BatchFolder) -> tuple[BatchCost, list[float]]:
    """Run a batch; returns its cost and the resident memory (MB) of its main process over time."""
    began, before = time.monotonic(), _children_cpu_seconds()
    process = place.start()
    memory: list[float] = []

    def follow() -> None:
        main = psutil.Process(process.pid)
        while process.poll() is None:
            with _IgnoreEndedProcess():
                memory.append(main.memory_info().rss / 1e6)
            time.sleep(0.2)

    follower = threading.Thread(target=follow)
    follower.start()
    process.communicate()
    follower.join()
    return BatchCost(process.returncode, time.monotonic() - began, _children_cpu_seconds() - before), memory[:-1] or [
        0.0
    ]


class _IgnoreEndedProcess:
    """Ignore errors about a process that has just ended."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> bool:
        return kind is not None and issubclass(kind, psutil.Error)


def _read_summary(place: BatchFolder) -> list[dict[str, str]]:
    with (place.out / "summary.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@dataclass
class Stopwatch:
    """A watcher that records the CPU seconds of each stage."""

    cost: dict[str, float] = field(default_factory=dict)
    begun: float = 0.0

    def start_stage(self, stage: str) -> Callable[[float], None]:
        self.begun = time.process_time()
        return lambda share: None

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        self.cost[stage] = time.process_time() - self.begun


@dataclass(frozen=True)
class ClipCost:
    """CPU seconds of one clip, and MB."""

    chain: float
    """Of a fresh process, including the cost of its imports."""
    following: float
    """Of the next clip of the process."""
    decode: float
    encode: float
    stages: dict[str, float]
    cache_mb: float
    results_mb: float

    @property
    def least(self) -> float:
        return self.decode + self.encode

    @property
    def times(self) -> float:
        return self.chain / self.least


def measure_clip(folder: Path, clip: Path) -> ClipCost:
    """Measure the chain, one decoding of the clip and one encoding of its slow motion, in this (fresh) process."""
    from pipeline.chain import run_clip
    from pipeline.engine.result_cache import ResultCache
    from pipeline.run_options import RunOptions
    from video.calibration.shot_segmentation import segment_shots
    from video.io.clip import open_clip

    watch, out = Stopwatch(), folder / f"out {clip.stem}"
    whole = measure_cpu(
        lambda: run_clip(clip, out, RunOptions(), ResultCache(folder / f"cache {clip.stem}"), watch) and None
    )
    places = folder / f"next {clip.stem}", ResultCache(folder / f"next cache {clip.stem}")
    following = measure_cpu(lambda: run_clip(clip, places[0], RunOptions(), places[1], Stopwatch()) and None)
    decode, encode = measure_least_cost(clip, out / "slow.mp4", folder / "again.mp4")
    watch.cost["(keys and files)"] = whole - sum(watch.cost.values())
    opened_clip = open_clip(clip)
    watch.cost["(shots, of long recordings only)"] = measure_cpu(lambda: segment_shots(opened_clip) and None)
    cache_mb, results_mb = _folder_megabytes(folder / f"cache {clip.stem}"), _folder_megabytes(out)
    return ClipCost(whole, following, decode, encode, watch.cost, cache_mb, results_mb)


def measure_median(folder: Path, clip: Path, times: int) -> tuple[Line, list[tuple[str, float, float]]]:
    """Return the table line of a clip and its stages with their shares, of the median of several fresh processes."""
    costs = []
    for k in range(times):
        (folder / f"time {k}").mkdir(exist_ok=True)
        with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
            costs.append(fresh.submit(measure_clip, folder / f"time {k}", clip).result())
    costs.sort(key=lambda one: one.times)
    one = costs[len(costs) // 2]
    with av.open(str(clip)) as film:
        stream = film.streams.video[0]
        size, seconds = f"{stream.width} x {stream.height}", float(film.duration or 0) / 1e6
    result = (
        f"{one.times:.1f}x, of {times} times {costs[0].times:.1f} to {costs[-1].times:.1f} ({one.chain:.1f} against"
        f" {one.decode:.1f} + {one.encode:.1f} CPU s; {one.following / one.least:.1f}x for the next clip of the"
        " process);"
        f" {one.cache_mb:.1f} MB of cache, {one.results_mb:.1f} MB of results"
    )
    stages = [(stage, spent, spent / one.least) for stage, spent in one.stages.items()]
    return (f"chain of {clip.name}, {size}, {seconds:.1f} s", "<= 4x", result, one.times <= 4), stages


def _folder_megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def write_cost_clips(folder: Path) -> list[Path]:
    """Write a sample clip at 720 and at 1080 lines, used where no clips are named."""
    return [
        write_small(SAMPLES / "overhead_pool.mp4", folder / f"pool_{lines}p.mp4", height=lines, start=0.0, seconds=9.0)
        for lines in (720, 1080)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=200, help="clips of the large batch")
    parser.add_argument("--pace", type=int, default=100, help="clips per batch when workers are compared")
    parser.add_argument("--only", nargs="+", default=["workers", "many", "cost"], help="parts to run")
    parser.add_argument("--cost-clips", nargs="+", type=Path, default=[], help="clips whose stages are measured")
    parser.add_argument("--times", type=int, default=3, help="odd number of cost measurements (default 3)")
    arguments = parser.parse_args()
    lines: list[Line] = []
    stages: dict[str, list[tuple[str, float, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "workers" in arguments.only:
            lines.append(compare_workers(folder / "pace", arguments.pace))
        if "many" in arguments.only:
            (folder / "batch").mkdir()
            lines += run_many(folder / "batch", arguments.clips)
        if "cost" in arguments.only:
            write_clips(folder / "compiled" / "clips", 1)
            BatchFolder(folder / "compiled", "once").run()
            for clip in arguments.cost_clips or write_cost_clips(folder):
                line, stages[clip.name] = measure_median(folder, clip, arguments.times)
                lines.append(line)
    print("| check | goal | result | met |\n|---|---|---|---|")
    for check, goal, result, met in lines:
        print(f"| {check} | {goal} | {result} | {'yes' if met else '**no**'} |")
    for clip_name, found_stages in stages.items():
        print(f"\n| stage of {clip_name} | CPU s | times decode + encode |\n|---|---|---|")
        for stage, spent, share in sorted(found_stages, key=lambda row: -row[1]):
            print(f"| {stage} | {spent:.2f} | {share:.2f} |")
        print(f"| median of stages | {np.median([spent for _, spent, _ in found_stages]):.2f} | |")
    return int(not all(met for *_, met in lines))


if __name__ == "__main__":
    sys.exit(main())
