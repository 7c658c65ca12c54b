"""Whether a neural residual predicts the snooker clips better than the physics alone.

    python benchmarks/residual_clips.py [-o DIR] [--reuse]

Clips are split in four: two quarters are fitted, one stops the training and decides, the last, which chose nothing, is
predicted: the typical open-loop miss of a chain of legs over 2 s from its first half second. Each quarter is the last
one once. Balls that hit others begin a new chain there; what balls do to each other has no part in this.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from filmed import asked_clips, filmed_clips, with_measured_noise
from run_folder import FOOTAGE

from models.core.scene import Table
from models.estimation.neural_residual.residual_training import prediction_errors, train_residual
from models.estimation.neural_residual.residual_windows import ResidualChains
from models.estimation.reconstruction.fit_shot import fit_shot
from models.estimation.whole_shot.cushion_chains import Leg, legs_of

QUARTERS = 4
MOVED = 0.02
"""m: shorter legs tell nothing."""
LAW = "han_2005"


def clips(folder: Path, reuse: bool) -> tuple[list[tuple[Leg, ...]], Table]:
    """Legs of every clip, and the table."""
    found, table = [], None
    for number, clip in enumerate(filmed_clips("snooker", folder, reuse)):
        table = clip.scene.table
        tracks = with_measured_noise(clip.tracks, table.ball_radius)
        legs = legs_of(tracks, fit_shot(clip.tracks, clip.scene).events, 1000 * number)
        found.append(moving(legs))
    if table is None:
        raise SystemExit(f"no snooker clips in {FOOTAGE}")
    return found, table


def moving(legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
    """Legs of chains whose first leg moves: the others are balls that a contact only touched."""
    still = {leg.chain for leg in legs if not leg.tied and (len(leg.t) < 3 or np.ptp(leg.xy, axis=0).max() < MOVED)}
    return tuple(leg for leg in legs if leg.chain not in still)


def main() -> int:
    arguments = asked_clips(__doc__)
    legs, table = clips(arguments.out, arguments.reuse)
    print("| held-out clips | chains | physics mm | network mm | switched on | delivered mm |")
    print("|---|---|---|---|---|---|")
    pooled = []
    for quarter in range(QUARTERS):
        parts: list[list[Leg]] = [[], [], [], []]
        for number, some in enumerate(legs):
            parts[(number - quarter) % QUARTERS].extend(some)
        held_out, stopping, fitted = tuple(parts[0]), tuple(parts[1]), (*parts[2], *parts[3])
        found = train_residual(fitted, stopping, table, LAW, seed=quarter)
        without = prediction_errors(ResidualChains(held_out, table, LAW), found.physics)
        trained = prediction_errors(ResidualChains(held_out, table, LAW, found.trained_weights), found.trained)
        delivered = trained if found.on else without
        pooled.append(np.stack([without, trained, delivered]))
        row(str([n for n in range(len(legs)) if n % QUARTERS == quarter]), pooled[-1], "on" if found.on else "off")
    row("all", np.concatenate(pooled, axis=1), "")
    return 0


def row(name: str, errors: np.ndarray, on: str) -> None:
    without, trained, delivered = 1000 * np.exp(np.log(np.maximum(errors, 1e-6)).mean(axis=1))
    print(f"| {name} | {errors.shape[1]} | {without:.1f} | {trained:.1f} | {on} | {delivered:.1f} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
