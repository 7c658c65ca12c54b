"""Whether a neural residual predicts shots better than the physics alone, on foreign tables that lack something or not.

    python benchmarks/residual.py [--lacking slope,nothing] [--seeds 20] [--first 0]

Per table 8 shots are fitted and 7 stop the training and decide on or off; 7 others, which chose nothing, are printed:
the typical open-loop miss over 2 s from the first half second of each shot, with the physics alone, with the network
whatever was decided, and as delivered. The physics is a mirror with restitution and friction on a level cloth.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from residual_shots import LACKING, SCATTER, TABLE, filmed

from models.estimation.neural_residual.residual_training import prediction_errors, train_residual, typical
from models.estimation.neural_residual.residual_windows import ResidualChains
from models.estimation.whole_shot.cushion_chains import Leg

FITTED, STOPPING, HELD_OUT = 8, 7, 7
LAW = "mirror"


@dataclass(frozen=True)
class Scored:
    """One table: typical misses on held-out shots in mm, and what the training said."""

    without: float
    trained: float
    delivered: float
    on: bool
    seconds: float


def joined(shots: list[tuple[Leg, ...]]) -> tuple[Leg, ...]:
    return tuple(leg for shot in shots for leg in shot)


def score(lacking: str, seed: int) -> Scored:
    shots = filmed(lacking, seed, FITTED + STOPPING + HELD_OUT)
    fitted, stopping, held_out = (joined(part) for part in (shots[:FITTED], shots[FITTED:-HELD_OUT], shots[-HELD_OUT:]))
    begun = time.process_time()
    found = train_residual(fitted, stopping, TABLE, LAW, seed, SCATTER)
    seconds = time.process_time() - begun
    bare = ResidualChains(held_out, TABLE, LAW, scatter=SCATTER)
    trained = ResidualChains(held_out, TABLE, LAW, found.trained_weights, scatter=SCATTER)
    without = 1000 * typical(prediction_errors(bare, found.physics))
    with_it = 1000 * typical(prediction_errors(trained, found.trained))
    return Scored(without, with_it, with_it if found.on else without, found.on, seconds)


def report(lacking: str, seeds: range) -> Iterator[str]:
    rows = []
    for seed in seeds:
        row = score(lacking, seed)
        rows.append(row)
        yield (f"  {lacking} {seed}: {row.without:.1f} mm without, {row.trained:.1f} trained, "
               f"{'on' if row.on else 'off'}, {row.seconds:.0f} s")  # fmt: skip
    without, trained, delivered = (
        np.array([getattr(row, name) for row in rows]) for name in ("without", "trained", "delivered")
    )
    gains = 1 - np.array([trained / without, delivered / without])
    yield (f"| {lacking} | {len(rows)} | {np.median(without):.1f} | {np.median(trained):.1f} "
           f"| {np.median(gains[0]):+.0%} | {sum(row.on for row in rows)} of {len(rows)} | {np.median(delivered):.1f} "
           f"| {np.median(gains[1]):+.0%} | {np.min(gains[1]):+.0%} |")  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lacking", default=",".join(LACKING), help="which tables")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    arguments = parser.parse_args()
    print("| lacking | tables | physics mm | network mm | its gain | switched on | delivered mm | gain | worst |")
    print("|---|---|---|---|---|---|---|---|---|")
    for lacking in arguments.lacking.split(","):
        for line in report(lacking, range(arguments.first, arguments.first + arguments.seeds)):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
