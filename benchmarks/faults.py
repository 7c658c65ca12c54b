"""What a batch withstands: kills, disks that are full, closed or gone, clips that change, hang or hold nonsense.

    python benchmarks/faults.py [--kills 100] [--inputs 2000] [--only kills tcp places fuzz] [--seed 0] [--minutes 60]

Prints one table of goals and what was found. Byte for byte means the csv, json, npz, png and mp4 of results and cache.
What needs a mount of its own is left out, and said so, where the user may not mount.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fault_kills import Toll, disturbed
from fault_places import places
from fault_runs import Place, contents, entries
from fuzzed_batch import fuzzed
from small_clips import write_clips

CLIPS = 3
Line = tuple[str, str, str, bool]
"""What is asked, the goal, what came, whether it is met."""


def kill_lines(title: str, toll: Toll) -> list[Line]:
    """The lines of a batch that was killed many times."""
    who = ", ".join(f"{count} {name}" for name, count in sorted(toll.killed.items()))
    return [
        (f"{title}: {sum(toll.killed.values())} kills ({who}; {toll.rounds} rounds, {toll.seconds:.0f} s)",
         "exit 0 of the rerun", f"exit {toll.status}", toll.status == 0),
        (f"{title}: files that differ after one rerun", "0", _told(toll.differing), not toll.differing),
        (f"{title}: torn files under a final name", "0", _told(sorted(toll.torn)), not toll.torn),
        (f"{title}: finished stages made again", "0", str(len(toll.again)), not toll.again),
        (f"{title}: processes that outlived their batch", "0", str(toll.survivors), not toll.survivors),
        (f"{title}: leftovers", "0", _told(toll.left), not toll.left),
    ]  # fmt: skip


def _told(names: list[str]) -> str:
    return f"{len(names)}" + (f" ({names[0]})" if names else "")


def checked(folder: Path, only: list[str], kills: int, inputs: int, seed: int, longest: float) -> list[Line]:
    """All lines; a machine that is full gets no further with its kills than it does in `longest` s."""
    rng, lines, pace = np.random.default_rng(seed), list[Line](), 0.0
    undisturbed = Place(folder, "whole")
    if {"kills", "tcp", "places"} & set(only):
        write_clips(undisturbed.clips, CLIPS)
        status, _, err = undisturbed.run("--jobs", "2")
        if status:
            raise SystemExit(f"the undisturbed run failed: {err}")
        began = time.monotonic()
        Place(folder, "timed").run("--jobs", "2")
        pace = (time.monotonic() - began) / CLIPS
    whole, stages = contents(undisturbed), entries(undisturbed.cache)
    if "kills" in only:
        lines += kill_lines("one machine", disturbed(folder, kills, rng, whole, stages, pace, False, longest))
    if "tcp" in only:
        lines += kill_lines(
            "scheduler and two workers", disturbed(folder, kills, rng, whole, stages, pace, True, longest)
        )
    if "places" in only:
        lines += places(folder, whole)
    if "fuzz" in only:
        lines += fuzzed(folder / "fuzz", inputs, rng)
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0, help="for the kills of one machine, or of a scheduler")
    parser.add_argument("--only", nargs="+", default=["kills", "tcp", "places", "fuzz"])
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = checked(Path(folder), given.only, given.kills, given.inputs, given.seed, 60 * given.minutes)
    print("| what | goal | found | met |\n|---|---|---|---|")
    for what, goal, found, met in lines:
        print(f"| {what} | {goal} | {found} | {'yes' if met else '**no**'} |")
    return int(not all(met for *_, met in lines))


if __name__ == "__main__":
    sys.exit(main())
