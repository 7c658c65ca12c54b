"""Measure the best speed-up of two processors of this machine: copies of a loop that share nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass, field

WAIT_FOR_START = "print(flush=True)\ninput()\n"
# A loop in pure Python, which fits into the first cache.
PURE_PYTHON = f"""
total = 0
{WAIT_FOR_START}
for k in range(12_000_000):
    total += k & 7
"""
# A loop that adds images to each other, 66 MB in total: more than the caches hold.
IMAGES = f"""
import numpy
ring = [numpy.full((720, 1280, 3), k, numpy.uint8) for k in range(24)]
{WAIT_FOR_START}for k in range(1500):
    numpy.add(ring[k % 24], ring[(k + 7) % 24], out=ring[(k + 13) % 24])
"""
LOOPS = {"pure Python": PURE_PYTHON, "images in memory": IMAGES}


@dataclass
class MachineCeiling:
    """Durations of the loops in s, by name and by number of simultaneous copies."""

    seconds: dict[str, dict[int, list[float]]] = field(default_factory=lambda: {name: {1: [], 2: []} for name in LOOPS})

    def measure(self, copies: int) -> None:
        """Run every loop once, with so many simultaneous copies and one processor each."""
        for name, loop in LOOPS.items():
            self.seconds[name][copies].append(_run_together(loop, copies))

    def speedups(self) -> dict[str, float]:
        """Return the best speed-up by two copies, by name of the loop."""
        return {name: 2 * min(took[1]) / min(took[2]) for name, took in self.seconds.items()}


def _run_together(loop: str, copies: int) -> float:
    """Return the seconds until simultaneously started copies of a loop have all ended."""
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(mine)[:copies])
    command = [sys.executable, "-c", loop]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(copies)
    ]
    os.sched_setaffinity(0, mine)
    for one in running:
        assert one.stdout is not None
        one.stdout.readline()  # waits until the process is ready
    began = time.monotonic()
    for one in running:
        assert one.stdin is not None
        print(file=one.stdin, flush=True)
    for one in running:
        one.wait()
    took = time.monotonic() - began
    for one in running:
        one.communicate()
    return took
