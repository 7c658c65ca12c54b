"""What two processors of this machine bring at best: copies of a loop that share nothing, one and two at a time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass, field

READY = "print(flush=True)\ninput()\n"
PURE = f"""
total = 0
{READY}
for k in range(12_000_000):
    total += k & 7
"""
"""Python alone: all of it fits into the first cache."""
PICTURES = f"""
import numpy
ring = [numpy.full((720, 1280, 3), k, numpy.uint8) for k in range(24)]
{READY}for k in range(1500):
    numpy.add(ring[k % 24], ring[(k + 7) % 24], out=ring[(k + 13) % 24])
"""
"""Pictures added to each other, 66 MB of them: more than the caches hold."""
LOOPS = {"pure Python": PURE, "pictures in memory": PICTURES}


@dataclass
class Ceiling:
    """s that loops took, by their name and by how many copies ran at a time."""

    seconds: dict[str, dict[int, list[float]]] = field(default_factory=lambda: {name: {1: [], 2: []} for name in LOOPS})

    def measure(self, copies: int) -> None:
        """Run every loop once, so many copies at a time, a processor for each."""
        for name, loop in LOOPS.items():
            self.seconds[name][copies].append(_together(loop, copies))

    def times(self) -> dict[str, float]:
        """How often as much two copies do in the time of one, at best, by the loop's name."""
        return {name: 2 * min(took[1]) / min(took[2]) for name, took in self.seconds.items()}


def _together(loop: str, copies: int) -> float:
    """s until so many copies of a loop, begun together, have all ended."""
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(mine)[:copies])
    command = [sys.executable, "-c", loop]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(copies)
    ]
    os.sched_setaffinity(0, mine)
    for one in running:
        assert one.stdout is not None
        one.stdout.readline()  # it is ready
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
