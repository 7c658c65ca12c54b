"""A test of a named effect that assumes nothing about the noise within a shot.

Without a missing effect, every shot pulls its strength to either side with equal chance, whatever the size,
correlation, resolution or tails of the noise. Flipping the signs of whole shots therefore gives the distribution of the
largest pull of any effect of the library (Hemerik, Goeman and Finos 2020, doi:10.1111/rssb.12369; maximum over all
effects: Westfall and Young 1993, Resampling-Based Multiple Testing, section 2.3).
"""

from __future__ import annotations

import numpy as np

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, ShotInformation
from diagnosis.selection.signatures import absorb_by_free, compute_signatures, whitening_directions
from models.core.typing import BoolArray, FloatArray

_MAX_EXACT_SHOTS = 13
"""Most shots of which all flips are tried: 4096, as the last shot keeps its sign."""
_MIN_SHOTS = 3
"""Fewest shots that are tested: two allow no p-value below a half."""


def flip_signs(
    problem: DiagnosisProblem, shot_information: ShotInformation, free: BoolArray, name: str, rng: np.random.Generator
) -> float:
    """Return the probability that shots without a missing effect agree about some effect as well as about this one.

    Args:
        problem: Scene and priors.
        shot_information: Information of each shot at a fit without the effect.
        free: (P,) mask of the parameters that this fit adjusts.
        name: The effect.
        rng: Random generator of the flips, where there are too many to try them all.

    Returns:
        p-value, at least 2 to the power of 1 - Q for Q shots; NaN where the effect has no strength, or shots are few.
    """
    masks = [problem.mask((other,)) & ~free for other in problem.candidates]
    own = problem.mask((name,)) & ~free
    if not own.any() or len(shot_information.shots) < _MIN_SHOTS:
        return float("nan")
    effect_signatures = compute_signatures(problem, shot_information, free)
    scores, whole = shot_information.score, shot_information.information.sum(axis=0)
    pulls = scores - absorb_by_free(problem, whole, free, scores[:, free].T).T
    flips = _draw_flips(len(pulls), rng)

    def measure(mask: BoolArray) -> FloatArray:
        directions = whitening_directions(effect_signatures, mask)
        along = flips @ (pulls[:, mask] @ directions)
        return np.asarray(np.square(along).sum(axis=1) / max(directions.shape[1], 1))

    largest = np.max([measure(mask) for mask in masks if mask.any()], axis=0)
    observed = measure(own)[0]
    return float(np.mean(largest >= observed * (1 - 1e-9)))


def smallest_p_value(count: int) -> float:
    """Return the smallest p-value that flips of `count` shots allow; NaN where they are too few to test."""
    return float(2.0 ** (1 - min(count, _MAX_EXACT_SHOTS))) if count >= _MIN_SHOTS else float("nan")


def _draw_flips(count: int, rng: np.random.Generator) -> FloatArray:
    """Draw signs (K, Q) of all shots, the observed ones first; a pull has the same size with all signs exchanged."""
    if count <= _MAX_EXACT_SHOTS:
        is_flipped = np.arange(2 ** (count - 1))[:, None] >> np.arange(count) & 1
    else:
        is_flipped = rng.integers(0, 2, (2 ** (_MAX_EXACT_SHOTS - 1), count))
        is_flipped[0] = 0
    return np.where(is_flipped, -1.0, 1.0)
