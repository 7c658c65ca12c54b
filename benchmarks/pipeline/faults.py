"""Test batches under faults: kills, full, read-only or lost disks, clips that change, hang or contain garbage.

    python -m benchmarks.pipeline.faults [--kills 100] [--inputs 2000] [--only kills tcp places fuzz] [--seed 0]
        [--minutes 60]

Takes hours with the defaults. Prints one table of goals and results. "Byte for byte" refers to the csv, json, npz, png
and mp4 files of results and cache. Checks that need a mount are skipped, and reported as such, where the user may not
mount.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.pipeline.fault_kills import KillReport, run_with_kills
from benchmarks.pipeline.fault_places import run_all
from benchmarks.pipeline.fault_runs import BatchFolder, hash_contents, read_manifests
from benchmarks.pipeline.fuzzed_batch import run_fuzzed_batch
from benchmarks.pipeline.small_clips import write_clips

CLIPS = 3
# Check, goal, result, and whether the goal is met.
Line = tuple[str, str, str, bool]


def kill_lines(title: str, report: KillReport) -> list[Line]:
    """Format the lines of a batch with many kills."""
    who = ", ".join(f"{count} {name}" for name, count in sorted(report.killed.items()))
    return [
        (f"{title}: {sum(report.killed.values())} kills ({who}; {report.rounds} rounds, {report.seconds:.0f} s)",
         "exit 0 of the rerun", f"exit {report.status}", report.status == 0),
        (f"{title}: files that differ after one rerun", "0", _summarize_names(report.differing), not report.differing),
        (f"{title}: torn files under a final name", "0", _summarize_names(sorted(report.torn_files)),
         not report.torn_files),
        (f"{title}: finished stages computed again", "0", str(len(report.repeated_stages)), not report.repeated_stages),
        (f"{title}: processes that outlived their batch", "0", str(report.survivors), not report.survivors),
        (f"{title}: leftovers", "0", _summarize_names(report.leftovers), not report.leftovers),
    ]  # fmt: skip


def _summarize_names(names: list[str]) -> str:
    return f"{len(names)}" + (f" ({names[0]})" if names else "")


def run_checks(folder: Path, only: list[str], kills: int, inputs: int, seed: int, longest: float) -> list[Line]:
    """Run the chosen checks; the kills of one part stop after `longest` s."""
    rng, lines, pace = np.random.default_rng(seed), list[Line](), 0.0
    undisturbed = BatchFolder(folder, "whole")
    if {"kills", "tcp", "places"} & set(only):
        write_clips(undisturbed.clips, CLIPS)
        status, _, err = undisturbed.run("--jobs", "2")
        if status:
            raise SystemExit(f"the undisturbed run failed: {err}")
        began = time.monotonic()
        BatchFolder(folder, "timed").run("--jobs", "2")
        pace = (time.monotonic() - began) / CLIPS
    whole, stages = hash_contents(undisturbed), read_manifests(undisturbed.cache)
    if "kills" in only:
        lines += kill_lines("one machine", run_with_kills(folder, kills, rng, whole, stages, pace, False, longest))
    if "tcp" in only:
        lines += kill_lines(
            "scheduler and two workers", run_with_kills(folder, kills, rng, whole, stages, pace, True, longest)
        )
    if "places" in only:
        lines += run_all(folder, whole)
    if "fuzz" in only:
        lines += run_fuzzed_batch(folder / "fuzz", inputs, rng)
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100, help="number of kills per part")
    parser.add_argument("--inputs", type=int, default=2000, help="number of fuzzed inputs")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="longest duration of the kills on one machine, or with a scheduler"
    )
    parser.add_argument("--only", nargs="+", default=["kills", "tcp", "places", "fuzz"], help="parts to run")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = run_checks(
            Path(folder), arguments.only, arguments.kills, arguments.inputs, arguments.seed, 60 * arguments.minutes
        )
    print("| check | goal | result | met |\n|---|---|---|---|")
    for check, goal, result, met in lines:
        print(f"| {check} | {goal} | {result} | {'yes' if met else '**no**'} |")
    return int(not all(met for *_, met in lines))


if __name__ == "__main__":
    sys.exit(main())
