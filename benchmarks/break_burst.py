"""What a burst's contacts hang on: the same break of another rack that no picture can tell from the first.

    python benchmarks/break_burst.py [--seeds 20] [--first 0] [--fps 30] [--racks 5] [--truth DIR]

Everything is known here, the laws, every number of them, the cue ball's motion, but not by how much each ball of the
rack lies off its place: at most half a millimetre, drawn anew, where twelve pictures before the strike place a ball to
0.6 mm. Printed: the share of the contacts of the burst (50 ms after the first, closing at 60 mm/s or more) that such a
rack has too, the same balls within half a picture, and the share of its own that are true: a forecast from all that can
be known finds no more. `benchmarks/breaks.py` counts contacts of the burst apart for this reason.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from break_shots import WORLD, Break, read, shot

BURST, SECONDS = 0.05, 0.6
"""s after the first contact, and s played."""
LEAST_SPEED = 0.06
"""m/s."""


def another_rack(seed: int, again: int) -> dict[str, object]:
    """The shot of a seed with each ball of the rack off its place by other amounts of the same size."""
    play = shot(seed, pockets=False, seconds=SECONDS)
    gap = np.random.default_rng(seed).uniform(1e-4, 1e-3)  # the first number that `shot` draws
    rng = np.random.default_rng([seed, again])
    balls = [dict(ball) for ball in play["balls"]]  # type: ignore[attr-defined]
    pitch = 2 * balls[0]["radius"] + gap
    rack = [(row * np.sqrt(0.75), j - row / 2) for row in range(5) for j in range(row + 1)]
    middle = np.array([1.85, play["table"]["width"] / 2])  # type: ignore[index]
    for ball, place in zip(balls[1:], rack, strict=True):
        ball["x"], ball["y"] = (middle + pitch * np.array(place) + rng.uniform(-gap / 2, gap / 2, 2)).tolist()
    return {**play, "balls": balls}


def played(play: dict[str, object], out: Path) -> Break:
    """What the world makes of a shot."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "shot.json").write_text(json.dumps(play))
    subprocess.run([sys.executable, str(WORLD), str(out / "shot.json"), str(out)], check=True)
    return read(out)


def burst(shown: Break) -> list[tuple[float, frozenset[str]]]:
    """Times, s, and partners of the fast contacts in the burst."""
    fast = (shown.speed > LEAST_SPEED) & (shown.kind == "ball")
    chosen = np.flatnonzero(fast & (shown.t <= shown.t[fast].min() + BURST))
    return [(float(shown.t[e]), frozenset((str(shown.a[e]), str(shown.b[e])))) for e in chosen]


def shared(of: list[tuple[float, frozenset[str]]], told: list[tuple[float, frozenset[str]]], apart: float) -> int:
    """How many contacts are told, each by one of the same balls at most `apart` s off."""
    left, found = list(told), 0
    for t, balls in of:
        near = [k for k, (when, who) in enumerate(left) if who == balls and abs(when - t) <= apart]
        if near:
            left.pop(min(near, key=lambda k: abs(left[k][0] - t)))
            found += 1
    return found


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--seeds", type=int, default=20)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--fps", type=float, default=30.0)
    asked.add_argument("--racks", type=int, default=5)
    asked.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll-bursts")
    given = asked.parse_args()
    found, true = [], []
    for seed in range(given.first, given.first + given.seeds):
        of = burst(played(shot(seed, False, SECONDS), given.truth / f"{seed}"))
        for again in range(given.racks):
            told = burst(played(another_rack(seed, again), given.truth / f"{seed}_{again}"))
            same = shared(of, told, 0.5 / given.fps)
            found.append(same / len(of))
            true.append(same / len(told))
        print(
            f"seed {seed}: {len(of)} contacts in the burst, {np.mean(found[-given.racks :]):.2f} of them again",
            flush=True,
        )
    print(
        f"contacts of the burst that such a rack has too: {np.mean(found):.2f}; of its own, true: {np.mean(true):.2f}"
    )


if __name__ == "__main__":
    main()
