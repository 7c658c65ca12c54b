"""Measure time (cold and cached) and peak memory of `trueroll run`, also for a clip ten times as long.

    python -m benchmarks.pipeline.run_cost [CLIP]

Without CLIP, the largest 720p sample is cut or repeated to 5 s. Takes several minutes; prints one table. Memory is the
largest resident set of the process as counted by the operating system.
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

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 5.0


@dataclass(frozen=True)
class RunCost:
    """Exit status, seconds and peak memory of a run."""

    status: int
    seconds: float
    peak_mib: float


def run_measured(clip: Path, out: Path, cache: Path) -> RunCost:
    """Measure one `trueroll run` as a separate process."""
    command = [str(Path(sys.executable).with_name("trueroll")), "run", str(clip), "-o", str(out)]
    start = time.perf_counter()
    process = subprocess.Popen(
        command,
        env=os.environ | {"TRUEROLL_CACHE": str(cache)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return RunCost(process.returncode, time.perf_counter() - start, usage.ru_maxrss / 1024)


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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", nargs="?", type=Path, help="a short clip; default: the largest 720p sample")
    source = parser.parse_args().clip or default_clip()
    print("| clip | length s | cold s | cold / length | cached s | peak MiB |\n|---|---|---|---|---|---|")
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for factor in (1, 10):
            clip = Path(folder) / f"{source.stem}-{factor}x.mp4"
            length = write_repeated(source, clip, factor * SECONDS)
            out, cache = Path(folder) / f"out{factor}", Path(folder) / f"cache{factor}"
            cold, warm = (run_measured(clip, out, cache) for _ in range(2))
            failed |= bool(cold.status or warm.status)
            print(
                f"| {clip.name} | {length:.1f} | {cold.seconds:.1f} | {cold.seconds / length:.1f} "
                f"| {warm.seconds:.1f} | {max(cold.peak_mib, warm.peak_mib):.0f} |"
            )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
