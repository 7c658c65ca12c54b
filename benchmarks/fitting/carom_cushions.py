"""Compare published cushion models on the carom clips by their predictions of unseen contacts.

    python -m benchmarks.fitting.carom_cushions [-o DIR] [--reuse]

Needs the footage of ../shared/data; takes some minutes. Each model is fitted to two clips (cloth, restitution,
friction, nose positions; spin hidden). In the third clip, every path after a cushion is predicted from the paths
before it and compared with the observed positions until the next contact. The frame rate of the clips is a guess, so
lengths are reported and no speeds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.fitting.cushion_chains import (
    ChainSegment,
    CushionChains,
    CushionLaw,
    chain_priors,
    extract_chain_segments,
    predict_motion,
)
from benchmarks.support.run_folder_tracks import measure_noise, parse_clip_arguments, read_filmed_clips
from models.core.scene import Table
from models.estimation.multiple_shooting.shooting_fit import (
    ShootingFit,
    ShootingOptions,
    convert_to_priors,
    fit_windows,
)
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge
from models.physics.effect import Prior

LAWS: dict[str, CushionLaw] = {
    "mirror": mirror.rebound,
    "han_2005": han_2005.rebound,
    "mathavan_2010": mathavan_2010.rebound,
    "stronge": stronge.rebound,
}
# More iterations change no figure of the table.
FIT_OPTIONS = ShootingOptions(iterations=15, shot_iterations=6)
# Share of bootstraps above which one model counts as better than another.
SURE_SHARE = 0.95
# Predicted length of the path after a cushion, s at the guessed frame rate.
PREDICTED_SECONDS = 1.0


@dataclass(frozen=True)
class CaromClip:
    """The segments of one clip on its table."""

    name: str
    table: Table
    segments: tuple[ChainSegment, ...]


@dataclass(frozen=True)
class CushionScore:
    """One cushion model: its fit to all clips, and its error (mm) at every held-out contact."""

    fit: ShootingFit
    errors: np.ndarray


def read_clips(folder: Path, reuse: bool) -> Iterator[CaromClip]:
    for number, clip in enumerate(read_filmed_clips("carom", folder, reuse)):
        table = clip.scene.table
        tracks = measure_noise(clip.tracks, table.ball_radius)
        yield CaromClip(
            clip.name,
            table,
            extract_chain_segments(tracks, view_shot(explain(clip.tracks, clip.scene)).events, 1000 * number),
        )


def score_law(law: CushionLaw, shots: list[CaromClip]) -> CushionScore:
    errors = [
        miss
        for held_out in shots
        for miss in _prediction_errors(
            law, held_out, _fit_clips(law, [shot for shot in shots if shot is not held_out])[1]
        )
    ]
    return CushionScore(_fit_clips(law, shots)[0], np.array(errors))


def _fit_clips(law: CushionLaw, shots: list[CaromClip]) -> tuple[ShootingFit, tuple[Prior, ...]]:
    """Fit some clips; returns the fit and its shared parameters as priors. Nose positions belong to one clip each."""
    fit = fit_windows(
        CushionChains(tuple(leg for shot in shots for leg in shot.segments), shots[0].table, law), options=FIT_OPTIONS
    )
    learned = convert_to_priors(chain_priors(), fit)
    return fit, tuple(
        prior if prior.name.startswith("nose") else now for prior, now in zip(chain_priors(), learned, strict=True)
    )


def _prediction_errors(law: CushionLaw, clip: CaromClip, priors: tuple[Prior, ...]) -> Iterator[float]:
    """Yield the RMS error (mm) of the path after each cushion, predicted from the paths before it."""
    for k, leg in enumerate(clip.segments):
        ahead = leg.t <= leg.begin + PREDICTED_SECONDS
        if not leg.continues_previous or not ahead.any():
            continue
        first = max(i for i in range(k) if not clip.segments[i].continues_previous)
        if sum(len(before.t) for before in clip.segments[first:k]) < 4:
            continue  # too few samples for a prediction
        model = CushionChains(clip.segments[first:k], clip.table, law, priors)
        fit = fit_windows(model, options=FIT_OPTIONS)
        start, _, _ = model.predict_past_cushion(clip.segments[k - 1], fit.starts[-1], leg.begin, fit.shared)
        positions, _, _ = predict_motion(start, leg.t[ahead] - leg.begin, fit.shared)
        yield 1000 * float(np.sqrt(((positions[:, :2] - leg.xy[ahead]) ** 2).sum(axis=1).mean()))


def main() -> int:
    arguments = parse_clip_arguments(__doc__)
    shots = list(read_clips(arguments.out, arguments.reuse))
    scored = {name: score_law(law, shots) for name, law in LAWS.items()}
    print("\n## Cushion models on the carom clips: held-out error of the path after a cushion\n")
    print(
        "| model | contacts | median mm | RMS mm | restitution e | cushion mu | sliding mu | log evidence | chi2/dof |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, one in scored.items():
        s, sigma = one.fit.shared, one.fit.sigma
        estimates = [f"{s[i]:.3f} +- {sigma[i]:.3f}" + (" (prior)" if one.fit.prior_only[i] else "") for i in (2, 3, 0)]
        print(f"| {name} | {len(one.errors)} | {np.median(one.errors):.0f} | {np.sqrt(np.mean(one.errors**2)):.0f} "
              f"| {' | '.join(estimates)} | {one.fit.log_evidence:.0f} | {one.fit.chi2_per_dof:.2f} |")  # fmt: skip
    best = min(scored, key=lambda name: float(np.median(scored[name].errors)))
    print(f"\nselected by the held-out median: {best}")
    rng = np.random.default_rng(0)
    rows = rng.integers(0, len(scored[best].errors), (2000, len(scored[best].errors)))
    for name, one in scored.items():
        if name != best:
            gain = np.median(one.errors[rows], axis=1) - np.median(scored[best].errors[rows], axis=1)
            print(f"  better than {name} in {np.mean(gain > 0):.0%} of bootstraps over contacts"
                  + ("" if np.mean(gain > 0) > SURE_SHARE else ": these clips do not distinguish the two"))  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
