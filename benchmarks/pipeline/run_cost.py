"""Measure `trueroll run`: its answer, its cost against the least possible one, and a clip ten times as long.

    python -m benchmarks.pipeline.run_cost [--quick] [CLIP] [--repeat 3] [--long]

Without CLIP, the largest 720p sample is cut or repeated to 5 s. Each round runs the clip with --quick --no-video and in
full, each from an empty cache, and measures the reference beside them: decoding the clip once and encoding its slow
motion once. Ratios therefore hold on a busy machine, wall-clock times do not. Compiled code is expected to be cached:
the first run on a machine compiles. The bytecode of Python is written even where the environment forbids it. At the end
the full run is repeated from its cache; --long adds a clip ten times as long. Takes about two minutes per round. Memory
is the largest resident set as counted by the operating system.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from benchmarks.pipeline.video_passes import measure_least_cost
from benchmarks.support.figures import Figure, add_quick_option, run_quick, state_cost

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 5.0
ANSWER_ONLY = ("--quick", "--no-video")
# Peak memory varies with how the allocator and two decoding threads interleave.
MEMORY_FACTOR = 1.25


@dataclass(frozen=True)
class RunCost:
    """Exit status, seconds and peak memory of a run."""

    status: int
    seconds: float
    first_answer: float
    """s until events and report were there."""
    cpu: float
    """CPU seconds, helper processes included."""
    peak_mib: float


def run_measured(clip: Path, out: Path, cache: Path, *options: str) -> RunCost:
    """Measure one `trueroll run` as a separate process."""
    command = [sys.executable, "-m", "trueroll", "run", str(clip), "-o", str(out), "--cache", str(cache), *options]
    start = time.perf_counter()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    answer = float("nan")
    for line in process.stdout:
        if line.startswith(b"Look at") and answer != answer:
            answer = time.perf_counter() - start
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return RunCost(
        process.returncode, time.perf_counter() - start, answer, usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss / 1024,
    )  # fmt: skip


def write_repeated(source: Path, path: Path, seconds: float) -> float:
    """Write the frames of `source` forwards and backwards until `seconds` are full; returns the length in s."""
    with av.open(str(source)) as container:
        stream = container.streams.video[0]
        rate = stream.average_rate or Fraction(30)
        frames = [f.to_ndarray(format="yuv420p") for f in container.decode(stream)]
        width, height = stream.codec_context.width, stream.codec_context.height
    count = round(seconds * rate)
    there_and_back = frames + frames[-2:0:-1]
    with av.open(str(path), "w") as container:
        out = container.add_stream("libx264", rate=rate, options={"crf": "20", "preset": "veryfast"})
        out.width, out.height, out.pix_fmt = width, height, "yuv420p"
        for k in range(count):
            frame = av.VideoFrame.from_ndarray(there_and_back[k % len(there_and_back)], format="yuv420p")
            container.mux(out.encode(frame))
        container.mux(out.encode())
    return float(count / rate)


def default_clip() -> Path:
    """Return the largest sample clip of 720 lines."""
    for path in sorted((ROOT / "sample_videos").glob("*.mp4"), key=lambda p: -p.stat().st_size):
        with av.open(str(path)) as container:
            if container.streams.video[0].codec_context.height == 720:
                return path
    raise SystemExit("no 720p clip in sample_videos/; name one")


@dataclass(frozen=True)
class Round:
    """A quick and a full run of a clip from an empty cache, and the reference, CPU s."""

    quick: RunCost
    full: RunCost
    decode: float
    encode: float

    @property
    def ratio(self) -> float:
        """CPU seconds of the full run over those of decoding and encoding once."""
        return self.full.cpu / (self.decode + self.encode)


def measure_round(clip: Path, folder: Path) -> Round:
    """Measure one round in an empty folder."""
    quick = run_measured(clip, folder / "quick", folder / "quick cache", *ANSWER_ONLY)
    full = run_measured(clip, folder / "full", folder / "cache")
    return Round(quick, full, *measure_least_cost(clip, folder / "full" / "slow.mp4", folder / "again.mp4"))


def print_round(name: str, one: Round) -> None:
    """Print a line of the table."""
    print(
        f"| {name} | {one.quick.first_answer:.1f} | {one.quick.seconds:.1f} | {one.quick.cpu:.1f} "
        f"| {one.full.first_answer:.1f} | {one.full.seconds:.1f} | {one.full.cpu:.1f} "
        f"| {one.decode:.2f} + {one.encode:.2f} | {one.ratio:.2f} |",
        flush=True,
    )


def measure_figures(source: Path) -> list[Figure]:
    """Measure the figures of the documentation: CPU seconds, which depend less on the load than wall-clock times."""
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        clip = scratch / "clip.mp4"
        write_repeated(source, clip, SECONDS)
        answer = run_measured(clip, scratch / "answer", scratch / "answer cache", *ANSWER_ONLY)
        full = run_measured(clip, scratch / "full", scratch / "cache")
        cached = run_measured(clip, scratch / "full", scratch / "cache")
    if answer.status or full.status or cached.status:
        raise SystemExit(f"trueroll run failed: {answer}, {full}, {cached}")
    return [
        state_cost("CPU time of the answer alone (`--quick --no-video`)", answer.cpu, "s", 1),
        state_cost("CPU time with the slow motion", full.cpu, "s", 1),
        state_cost("CPU time from the cache", cached.cpu, "s", 1),
        state_cost("peak memory", full.peak_mib, "MiB", 1, MEMORY_FACTOR),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("clip", nargs="?", type=Path, help="a short clip; default: the largest 720p sample")
    parser.add_argument("--repeat", type=int, default=3, help="number of rounds (default 3)")
    parser.add_argument("--long", action="store_true", help="also run the clip ten times as long")
    arguments = parser.parse_args()
    source = arguments.clip or default_clip()
    if arguments.quick:
        inputs = (
            f"{SECONDS:g} s of `{source.name}`, compiled code cached; the noise allows for twice the time under load"
        )
        run_quick("pipeline.run_cost", lambda: measure_figures(source), inputs, alone=True)
        return 0
    failed = False
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        clip = scratch / f"{source.stem}-1x.mp4"
        length = write_repeated(source, clip, SECONDS)
        print(f"{clip.name}, {length:.1f} s; times in s, goals: quick answer 10 s, ratio 2.5\n")
        print(
            "| round | quick: answer | whole | CPU | full: answer | whole | CPU | decode + encode CPU "
            "| full CPU / (decode + encode) |\n" + "|---" * 9 + "|"
        )
        rounds = []
        for k in range(arguments.repeat):
            (scratch / str(k)).mkdir()
            rounds.append(measure_round(clip, scratch / str(k)))
            print_round(str(k + 1), rounds[-1])
            failed |= bool(rounds[-1].quick.status or rounds[-1].full.status)
        values = [(one.quick.first_answer, one.full.first_answer, one.ratio) for one in rounds]
        print("\nmedian: quick answer {:.1f} s, full answer {:.1f} s, ratio {:.2f}".format(*np.median(values, axis=0)))
        last = scratch / str(arguments.repeat - 1)
        cached = run_measured(clip, last / "full", last / "cache")
        after_quick = run_measured(clip, last / "next", last / "quick cache")
        peak = max(one.full.peak_mib for one in rounds)
        print(
            f"full run from its cache {cached.seconds:.1f} s; after the quick run {after_quick.cpu:.1f} CPU s"
            f" of {rounds[-1].full.cpu:.1f}; peak memory {peak:.0f} MiB"
        )
        if arguments.long:
            clip = scratch / f"{source.stem}-10x.mp4"
            length = write_repeated(source, clip, 10 * SECONDS)
            cost = run_measured(clip, scratch / "long", scratch / "long cache")
            failed |= bool(cost.status)
            print(f"{clip.name}: {length:.1f} s take {cost.seconds:.1f} s, {cost.peak_mib:.0f} MiB")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
