"""Measure how ambiguous the contacts of a break are: break a second rack that no frame can distinguish from the first.

    python -m benchmarks.tracking.break_ambiguity [--quick] [--seeds 20] [--first 0] [--fps 30] [--racks 5]
        [--truth DIR]

Contact models, all parameters and the motion of the cue ball are known here, but not the small displacements of the
balls in the rack: at most half a millimetre, redrawn, where twelve frames before the strike locate a ball to 0.6 mm.
Printed: the share of the early contacts (50 ms after the first, closing at 60 mm/s or more) that such a rack repeats,
with the same balls within half a frame, and the share of its own contacts that are true: no prediction from the
available information can be better. `benchmarks/tracking/breaks.py` counts these contacts separately for this reason.
Takes seconds per rack.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.support.figures import Figure, add_quick_option, estimate_mean, run_quick
from benchmarks.tracking.break_shots import WORLD, Break, draw_shot, read_break

# Counted time after the first contact, and simulated time, s.
EARLY_SECONDS, SECONDS = 0.05, 0.6
QUICK_SEEDS = 6
# Least closing speed of a counted contact, m/s.
LEAST_SPEED = 0.06


def redraw_rack(seed: int, again: int) -> dict[str, object]:
    """Return the shot of a seed with redrawn displacements of the balls in the rack."""
    play = draw_shot(seed, pockets=False, seconds=SECONDS)
    gap = np.random.default_rng(seed).uniform(1e-4, 1e-3)  # the first number that `shot` draws
    rng = np.random.default_rng([seed, again])
    balls = [dict(ball) for ball in play["balls"]]  # type: ignore[attr-defined]
    pitch = 2 * balls[0]["radius"] + gap
    rack = [(row * np.sqrt(0.75), j - row / 2) for row in range(5) for j in range(row + 1)]
    middle = np.array([1.85, play["table"]["width"] / 2])  # type: ignore[index]
    for ball, place in zip(balls[1:], rack, strict=True):
        ball["x"], ball["y"] = (middle + pitch * np.array(place) + rng.uniform(-gap / 2, gap / 2, 2)).tolist()
    return {**play, "balls": balls}


def play_shot(play: dict[str, object], out: Path) -> Break:
    """Simulate a shot with worlds/billiards.py."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "shot.json").write_text(json.dumps(play))
    subprocess.run([sys.executable, str(WORLD), str(out / "shot.json"), str(out)], check=True)
    return read_break(out)


def select_early_contacts(shown: Break) -> list[tuple[float, frozenset[str]]]:
    """Return times (s) and balls of the fast contacts within `EARLY_SECONDS`."""
    fast = (shown.speed > LEAST_SPEED) & (shown.kind == "ball")
    chosen = np.flatnonzero(fast & (shown.t <= shown.t[fast].min() + EARLY_SECONDS))
    return [(float(shown.t[e]), frozenset((str(shown.a[e]), str(shown.b[e])))) for e in chosen]


def count_shared(
    reference: list[tuple[float, frozenset[str]]], other: list[tuple[float, frozenset[str]]], apart: float
) -> int:
    """Count reference contacts that have a contact of the same balls at most `apart` s away."""
    left, count = list(other), 0
    for t, balls in reference:
        near = [k for k, (when, pair) in enumerate(left) if pair == balls and abs(when - t) <= apart]
        if near:
            left.pop(min(near, key=lambda k: abs(left[k][0] - t)))
            count += 1
    return count


def compare_racks(seed: int, racks: int, fps: float, truth: Path) -> tuple[int, list[float], list[float]]:
    """Return the early contacts of a break, and by redrawn rack the repeated share and the share that is true."""
    reference = select_early_contacts(play_shot(draw_shot(seed, False, SECONDS), truth / f"{seed}"))
    recall, precision = [], []
    for again in range(racks):
        other = select_early_contacts(play_shot(redraw_rack(seed, again), truth / f"{seed}_{again}"))
        same = count_shared(reference, other, 0.5 / fps)
        recall.append(same / len(reference))
        precision.append(same / len(other))
    return len(reference), recall, precision


def measure_figures(fps: float, truth: Path) -> list[Figure]:
    """Measure the figures of the documentation on few breaks, one redrawn rack each."""
    shares = [compare_racks(seed, 1, fps, truth)[1:] for seed in range(QUICK_SEEDS)]
    recall, precision = 100 * np.array(shares)[..., 0].T
    return [
        estimate_mean("early contacts that a redrawn rack repeats", recall, "%"),
        estimate_mean("early contacts of a redrawn rack that are true", precision, "%"),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--seeds", type=int, default=20, help="number of breaks")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--fps", type=float, default=30.0, help="frame rate that sets the time tolerance")
    parser.add_argument("--racks", type=int, default=5, help="redrawn racks per break")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll-breaks-redrawn",
                        help="folder in which simulated shots are kept")  # fmt: skip
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"seeds 0 to {QUICK_SEEDS - 1}, one redrawn rack each"
        with tempfile.TemporaryDirectory() as fresh:  # the truth of this code
            run_quick("tracking.break_ambiguity", lambda: measure_figures(arguments.fps, Path(fresh)), inputs)
        return
    all_recall, all_precision = [], []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        count, recall, precision = compare_racks(seed, arguments.racks, arguments.fps, arguments.truth)
        all_recall += recall
        all_precision += precision
        print(f"seed {seed}: {count} contacts within 50 ms, {np.mean(recall):.2f} of them repeated", flush=True)
    print(f"early contacts that a redrawn rack repeats: {np.mean(all_recall):.2f}; "
          f"its own contacts that are true: {np.mean(all_precision):.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
