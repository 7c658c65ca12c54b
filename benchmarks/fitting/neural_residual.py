"""Measure whether a neural residual predicts shots better than the physics alone, with a missing effect or none.

    python -m benchmarks.fitting.neural_residual [--lacking slope,nothing] [--seeds 20] [--first 0]

Takes minutes per table. The tables are simulated by worlds/billiards.py. Per table, 8 shots are fitted, 7 stop the
training and decide whether the residual is enabled, and 7 reporting shots, not used before, are scored: the
typical open-loop error over 2 s from the first half second of each shot, with the physics alone, with the network
regardless of the decision, and as delivered. The physics is a mirror with restitution and friction on a level cloth.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.fitting.residual_shots import MISSING_EFFECTS, SCATTER, TABLE, film_table
from models.estimation.neural_residual.residual_training import geometric_mean_error, prediction_errors, train_residual
from models.estimation.neural_residual.residual_windows import ResidualChains
from models.estimation.whole_shot.cushion_chains import ChainSegment

FITTED, STOPPING, HELD_OUT = 8, 7, 7
LAW = "mirror"


@dataclass(frozen=True)
class ResidualScore:
    """One table: typical errors on hold-out shots, mm, and the decision of the training."""

    without: float
    trained: float
    delivered: float
    on: bool
    seconds: float


def join_segments(shots: list[tuple[ChainSegment, ...]]) -> tuple[ChainSegment, ...]:
    return tuple(segment for shot in shots for segment in shot)


def score_table(lacking: str, seed: int) -> ResidualScore:
    shots = film_table(lacking, seed, FITTED + STOPPING + HELD_OUT)
    fitted, stopping, held_out = (
        join_segments(part) for part in (shots[:FITTED], shots[FITTED:-HELD_OUT], shots[-HELD_OUT:])
    )
    begun = time.process_time()
    training = train_residual(fitted, stopping, TABLE, LAW, seed, SCATTER)
    seconds = time.process_time() - begun
    bare = ResidualChains(held_out, TABLE, LAW, scatter=SCATTER)
    trained = ResidualChains(held_out, TABLE, LAW, training.weight_priors, scatter=SCATTER)
    error_without = 1000 * geometric_mean_error(prediction_errors(bare, training.physics_values))
    error_with = 1000 * geometric_mean_error(prediction_errors(trained, training.best_values))
    return ResidualScore(
        error_without, error_with, error_with if training.is_enabled else error_without, training.is_enabled, seconds
    )


def report_tables(lacking: str, seeds: range) -> Iterator[str]:
    rows = []
    for seed in seeds:
        row = score_table(lacking, seed)
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
    parser.add_argument(
        "--lacking", default=",".join(MISSING_EFFECTS), help="missing effects of the tables, separated by commas"
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    arguments = parser.parse_args()
    print(
        "| missing effect | tables | physics mm | network mm | its gain | switched on | delivered mm | gain | worst |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for lacking in arguments.lacking.split(","):
        for line in report_tables(lacking, range(arguments.first, arguments.first + arguments.seeds)):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
