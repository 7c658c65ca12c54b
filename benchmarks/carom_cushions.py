"""Which published law the cushions of the carom clips obey, by what it predicts of contacts that it has not seen.

    python benchmarks/carom_cushions.py [-o DIR] [--reuse]

Each law is fitted to two clips (cloth, restitution, friction, noses; spin hidden). In the third one, every path after
a cushion is predicted from the paths before it, and compared with where the ball was seen until its next contact.
Clips run at a guessed rate: lengths are claimed here, no speeds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from filmed import asked_clips, filmed_clips, with_measured_noise

from models.core.scene import Table
from models.estimation.multiple_shooting.shooting_fit import Shooting, ShootingOptions, priors_of, shoot
from models.estimation.reconstruction.fit_shot import fit_shot
from models.estimation.whole_shot.cushion_chains import CushionChains, Leg, Rebound, chain_priors, glide, legs_of
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge
from models.physics.effect import Prior

LAWS: dict[str, Rebound] = {
    "mirror": mirror.rebound,
    "han_2005": han_2005.rebound,
    "mathavan_2010": mathavan_2010.rebound,
    "stronge": stronge.rebound,
}
ENOUGH = ShootingOptions(iterations=15, settling=6)
"""more changes no figure of the table."""
SURE = 0.95
"""share of bootstraps above which one law beats another."""
AHEAD = 1.0
"""s of the path after a cushion that are predicted, at the guessed rate."""


@dataclass(frozen=True)
class Clip:
    """The legs of one clip on its table."""

    name: str
    table: Table
    legs: tuple[Leg, ...]


@dataclass(frozen=True)
class Scored:
    """One law: its fit to all clips, and its misses (mm) of every held-out contact."""

    fit: Shooting
    misses: np.ndarray


def clips(folder: Path, reuse: bool) -> Iterator[Clip]:
    for number, clip in enumerate(filmed_clips("carom", folder, reuse)):
        table = clip.scene.table
        tracks = with_measured_noise(clip.tracks, table.ball_radius)
        yield Clip(clip.name, table, legs_of(tracks, fit_shot(clip.tracks, clip.scene).events, 1000 * number))


def score(law: Rebound, shots: list[Clip]) -> Scored:
    misses = [
        miss
        for held_out in shots
        for miss in _misses(law, held_out, _learn(law, [shot for shot in shots if shot is not held_out])[1])
    ]
    return Scored(_learn(law, shots)[0], np.array(misses))


def _learn(law: Rebound, shots: list[Clip]) -> tuple[Shooting, tuple[Prior, ...]]:
    """The fit of some clips, and its shared numbers as knowledge for others; noses are each clip's own."""
    fit = shoot(CushionChains(tuple(leg for shot in shots for leg in shot.legs), shots[0].table, law), options=ENOUGH)
    learned = priors_of(chain_priors(), fit)
    return fit, tuple(
        prior if prior.name.startswith("nose") else now for prior, now in zip(chain_priors(), learned, strict=True)
    )


def _misses(law: Rebound, clip: Clip, known: tuple[Prior, ...]) -> Iterator[float]:
    """mm RMS of the path after each cushion, predicted from the paths before it."""
    for k, leg in enumerate(clip.legs):
        ahead = leg.t <= leg.begin + AHEAD
        if not leg.tied or not ahead.any():
            continue
        first = max(i for i in range(k) if not clip.legs[i].tied)
        if sum(len(before.t) for before in clip.legs[first:k]) < 4:
            continue  # nothing was seen from which to predict
        model = CushionChains(clip.legs[first:k], clip.table, law, known)
        fit = shoot(model, options=ENOUGH)
        start, _, _ = model.hop(clip.legs[k - 1], fit.starts[-1], leg.begin, fit.shared)
        places, _, _ = glide(start, leg.t[ahead] - leg.begin, fit.shared)
        yield 1000 * float(np.sqrt(((places[:, :2] - leg.xy[ahead]) ** 2).sum(axis=1).mean()))


def main() -> int:
    arguments = asked_clips(__doc__)
    shots = list(clips(arguments.out, arguments.reuse))
    scored = {name: score(law, shots) for name, law in LAWS.items()}
    print("\n## Cushion laws on the carom clips: held-out error of the path after a cushion\n")
    print("| law | contacts | median mm | RMS mm | restitution e | cushion mu | sliding mu | log evidence | chi2/dof |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, one in scored.items():
        s, sigma = one.fit.shared, one.fit.sigma
        told = [f"{s[i]:.3f} +- {sigma[i]:.3f}" + (" (prior)" if one.fit.prior_only[i] else "") for i in (2, 3, 0)]
        print(f"| {name} | {len(one.misses)} | {np.median(one.misses):.0f} | {np.sqrt(np.mean(one.misses**2)):.0f} "
              f"| {' | '.join(told)} | {one.fit.log_evidence:.0f} | {one.fit.chi2_per_dof:.2f} |")  # fmt: skip
    best = min(scored, key=lambda name: float(np.median(scored[name].misses)))
    print(f"\nchosen by the held-out median: {best}")
    rng = np.random.default_rng(0)
    rows = rng.integers(0, len(scored[best].misses), (2000, len(scored[best].misses)))
    for name, one in scored.items():
        if name != best:
            gain = np.median(one.misses[rows], axis=1) - np.median(scored[best].misses[rows], axis=1)
            print(f"  better than {name} in {np.mean(gain > 0):.0%} of bootstraps over contacts"
                  + ("" if np.mean(gain > 0) > SURE else ": these clips do not tell the two apart"))  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
