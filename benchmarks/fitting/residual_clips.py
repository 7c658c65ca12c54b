"""Measure whether a neural residual predicts the snooker clips better than the physics alone.

    python -m benchmarks.fitting.residual_clips [-o DIR] [--reuse]

Needs the footage of ../shared/data; trains four networks. The clips are split in four: two quarters are fitted, one
stops the training and decides whether the residual is enabled, and the last, not used before, is scored: the typical
open-loop error of a chain of segments over 2 s from its first half second. Each quarter is the last one once. A ball
contact ends a chain and starts a new one; the contacts themselves are not part of this.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks.support.run_folder import FOOTAGE
from benchmarks.support.run_folder_tracks import measure_noise, parse_clip_arguments, read_filmed_clips
from models.core.scene import Table
from models.estimation.neural_residual.residual_training import prediction_errors, train_residual
from models.estimation.neural_residual.residual_windows import ResidualChains
from models.estimation.reconstruction.fit_shot import fit_shot
from models.estimation.whole_shot.cushion_chains import ChainSegment, extract_chain_segments

QUARTERS = 4
LEAST_MOTION = 0.02
"""Shorter segments are not used, m."""
LAW = "han_2005"


def read_clips(folder: Path, reuse: bool) -> tuple[list[tuple[ChainSegment, ...]], Table]:
    """Read the segments of every clip, and the table."""
    segments, table = [], None
    for number, clip in enumerate(read_filmed_clips("snooker", folder, reuse)):
        table = clip.scene.table
        tracks = measure_noise(clip.tracks, table.ball_radius)
        legs = extract_chain_segments(tracks, fit_shot(clip.tracks, clip.scene).events, 1000 * number)
        segments.append(select_moving(legs))
    if table is None:
        raise SystemExit(f"no snooker clips in {FOOTAGE}")
    return segments, table


def select_moving(legs: tuple[ChainSegment, ...]) -> tuple[ChainSegment, ...]:
    """Select the segments of chains whose first segment moves; other balls barely move after a contact."""
    still = {
        leg.chain
        for leg in legs
        if not leg.continues_previous and (len(leg.t) < 3 or np.ptp(leg.xy, axis=0).max() < LEAST_MOTION)
    }
    return tuple(leg for leg in legs if leg.chain not in still)


def main() -> int:
    arguments = parse_clip_arguments(__doc__)
    legs, table = read_clips(arguments.out, arguments.reuse)
    print("| held-out clips | chains | physics mm | network mm | switched on | delivered mm |")
    print("|---|---|---|---|---|---|")
    pooled = []
    for quarter in range(QUARTERS):
        parts: list[list[ChainSegment]] = [[], [], [], []]
        for number, some in enumerate(legs):
            parts[(number - quarter) % QUARTERS].extend(some)
        held_out, stopping, fitted = tuple(parts[0]), tuple(parts[1]), (*parts[2], *parts[3])
        training = train_residual(fitted, stopping, table, LAW, seed=quarter)
        without = prediction_errors(ResidualChains(held_out, table, LAW), training.physics_values)
        trained = prediction_errors(ResidualChains(held_out, table, LAW, training.weight_priors), training.best_values)
        delivered = trained if training.is_enabled else without
        pooled.append(np.stack([without, trained, delivered]))
        print_row(
            str([n for n in range(len(legs)) if n % QUARTERS == quarter]),
            pooled[-1],
            "on" if training.is_enabled else "off",
        )
    print_row("all", np.concatenate(pooled, axis=1), "")
    return 0


def print_row(name: str, errors: np.ndarray, on: str) -> None:
    without, trained, delivered = 1000 * np.exp(np.log(np.maximum(errors, 1e-6)).mean(axis=1))
    print(f"| {name} | {errors.shape[1]} | {without:.1f} | {trained:.1f} | {on} | {delivered:.1f} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
