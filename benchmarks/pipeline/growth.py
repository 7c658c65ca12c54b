"""Measure how the cost of a run grows with the length of a clip, that of a diagnosis with its shots, and a first use.

    python -m benchmarks.pipeline.growth [--plot docs/images/growth.svg] [--only clips|shots|first]

Clips of 5, 20 and 50 s are the largest 720p sample, forwards and backwards; sets of 6, 24 and 96 shots lack a slope, as
in `billiards_gap`. Growth is the cost of a further second or shot at the long end over that at the short end: 1 is
linear. The first use copies the source to a folder without compiled code and runs a clip, then a prediction, then a
diagnosis of twelve simulated shots there. Takes about ten minutes on two idle cores.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.diagnosis.billiards_gap import run_trial
from benchmarks.diagnosis.billiards_gap_cases import CASES
from benchmarks.pipeline.run_cost import ROOT, default_clip, run_measured, write_repeated

LENGTHS, SHOTS = (5.0, 20.0, 50.0), (6, 24, 96)
SEED = 150
# What a first use does, one after another, in the folder of the clip; a diagnosis needs more shots than one.
FIRST_USES = {
    "run": ("trueroll", "run", "clip.mp4", "-o", "out"),
    "predict": ("trueroll", "predict", "out"),
    "diagnose": ("benchmarks.diagnosis.billiards_gap", "slope"),
}
Costs = list[tuple[float, float]]


def measure_clips(scratch: Path) -> Costs:
    """Measure CPU seconds of full runs over the length of the clip."""
    costs = []
    for seconds in LENGTHS:
        clip = scratch / f"{seconds:g}.mp4"
        length = write_repeated(default_clip(), clip, seconds)
        cost = run_measured(clip, scratch / f"{seconds:g}", scratch / f"cache {seconds:g}")
        if cost.status:
            raise SystemExit(f"trueroll run failed: {cost}")
        print(f"| a clip of {length:.0f} s | {cost.cpu:.1f} | {cost.peak_mib:.0f} |", flush=True)
        costs.append((length, cost.cpu))
    return costs


def measure_shots() -> Costs:
    """Measure CPU seconds of diagnoses over the number of shots."""
    costs = []
    for shots in SHOTS:
        row = run_trial(replace(CASES["slope"], shots=shots), SEED)
        print(f"| a diagnosis of {shots} shots: {row.answer} | {row.cpu:.1f} | |", flush=True)
        costs.append((float(shots), row.cpu))
    return costs


def measure_first_use(scratch: Path) -> None:
    """Print wall-clock and CPU seconds, and compiled functions, of the first commands of a new copy of the source."""
    tree = scratch / "tree"
    files = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True).split("\0")
    for name in filter(None, files):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tree / name)
    write_repeated(default_clip(), scratch / "clip.mp4", LENGTHS[0])
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"PYTHONPATH": str(tree)}
    environment.pop("NUMBA_CACHE_DIR", None)
    for name, command in FIRST_USES.items():
        for again in ("", ", again"):
            start = time.perf_counter()
            options = ["--cache", f"cache{again}"] if name == "run" else []
            process = subprocess.Popen(
                [sys.executable, "-m", *command, *options], cwd=scratch, env=environment,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            _, status, usage = os.wait4(process.pid, 0)
            wall, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
            compiled = sum(1 for _ in tree.rglob("*.nbc"))
            print(f"| {name}{again} | {wall:.1f} | {cpu:.1f} | {compiled} |", flush=True)


def measure_growth(costs: Costs) -> float:
    """Divide the cost of a further unit at the long end by that at the short end."""
    (a, one), (b, two), (c, three) = costs
    return (three - two) / (c - b) / ((two - one) / (b - a))


def plot(clips: Costs, shots: Costs, path: Path) -> None:
    """Plot the costs over length and number, with the line through the first two."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    both = (clips, "length of the clip (s)"), (shots, "shots of a diagnosis")
    for axes, (costs, label) in zip(figure.subplots(1, 2), both, strict=True):
        x, y = zip(*costs, strict=True)
        slope = (y[1] - y[0]) / (x[1] - x[0])
        axes.plot((0.0, x[2]), (y[0] - slope * x[0], y[0] + slope * (x[2] - x[0])), "--", color="0.6", label="linear")
        axes.plot(x, y, "o-", color="#1f5f99", label="measured")
        axes.set(xlabel=label, ylabel="CPU seconds", xlim=(0.0, None), ylim=(0.0, None))
        axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=Path, help="SVG file of the growth")
    parser.add_argument("--only", choices=("clips", "shots", "first"), help="one part alone")
    options = parser.parse_args()
    if options.plot and options.only:
        parser.error("--plot needs clips and shots; leave out --only")
    with tempfile.TemporaryDirectory() as name:
        clips, shots = [], []
        if options.only != "first":
            print("| what | CPU s | peak MiB |\n|---|---|---|")
        if options.only in (None, "clips"):
            clips = measure_clips(Path(name))
        if options.only in (None, "shots"):
            shots = measure_shots()
        for label, costs in (("clips", clips), ("shots", shots)):
            if costs:
                print(f"growth with {label}: {measure_growth(costs):.2f}")
        if clips and shots and options.plot:
            plot(clips, shots, options.plot)
        if options.only in (None, "first"):
            print("\n| command | s | CPU s | compiled functions |\n|---|---|---|---|")
            measure_first_use(Path(name))


if __name__ == "__main__":
    main()
