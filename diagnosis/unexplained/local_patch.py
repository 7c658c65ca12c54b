"""A patch of the plane in which bodies are braked more, or less, than around it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from diagnosis.unexplained.excess_acceleration import ExcessAcceleration
from models.core.typing import BoolArray, FloatArray

# Probability of a patch in motion that is the same everywhere.
PATCH_SIGNIFICANCE = 0.005
# Radii of the discs that are tried, as shares of the largest extent of the motion: each half as large again.
_RADII = (0.04, 0.06, 0.09, 0.13, 0.18)
# The same for proposals: where the fit of the paths decides, a disc may hold most of the pieces.
_PROPOSED_RADII = (*_RADII, 0.27, 0.4)
# Least number of pieces of motion inside a proposed disc, and outside.
_MIN_PROPOSED_INSIDE = 2
# Probability of any proposal in motion that is the same everywhere: a fit that would hardly succeed takes seconds.
_PROPOSAL_SIGNIFICANCE = 0.05
# Speed from which a body moves, as a share of the largest: a body at rest shows no friction.
_MIN_SPEED_SHARE = 0.05
# Least number of pieces of motion inside a patch, and outside.
_MIN_INSIDE = 4
# Number of shuffled accelerations that give the significance: twice the inverse of it.
_SHUFFLES = 400
# Number of bootstrap draws of shots that give the errors.
_DRAWS = 100


@dataclass(frozen=True, slots=True)
class LocalPatch:
    """A disc in which the acceleration along the motion differs from that around it."""

    centre: FloatArray
    """(2,) m."""
    centre_sigma: float
    """m, of each coordinate."""
    radius: float
    """m."""
    radius_sigma: float
    """m."""
    strength: float
    """m/s^2 along the motion, inside minus outside; negative where bodies are braked."""
    strength_sigma: float
    """m/s^2."""
    p_value: float
    """Probability of such a difference in motion that is the same everywhere."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc that may hold a patch."""

    centre: FloatArray
    """(2,) m."""
    radius: float
    """m."""
    strength: float
    """m/s^2 along the motion, inside minus outside."""


def propose_discs(excess: ExcessAcceleration, count: int) -> tuple[tuple[Disc, ...], int]:
    """Propose discs with a clear difference of the acceleration along the motion, each at a place of its own.

    Args:
        excess: Accelerations of M pieces of motion in a plane.
        count: Largest number of proposals.

    Returns:
        Discs, the most significant first, and the number of discs that they were selected from.
    """
    moving = _select_moving(excess)
    if len(moving.sigma) < 2 * _MIN_PROPOSED_INSIDE or moving.position.shape[1] != 2:
        return (), 0
    values, weights = _weigh_along(moving)
    centres, radii, inside = _list_discs(moving.position, _PROPOSED_RADII, _MIN_PROPOSED_INSIDE)
    if not len(radii):
        return (), 0
    score = _score_discs(values[:, None], weights[:, None], inside)[:, 0]
    chosen: list[int] = []
    clear = score > norm.isf(_PROPOSAL_SIGNIFICANCE / 2 / len(radii))
    for k in np.flatnonzero(clear)[np.argsort(-score[clear], kind="stable")]:
        apart = np.linalg.norm(centres[chosen] - centres[k], axis=1)
        if (apart > np.minimum(radii[chosen], radii[k])).all():
            chosen.append(int(k))
        if len(chosen) == count:
            break
    discs = (Disc(centres[k], float(radii[k]), _difference(values, weights, inside[k])) for k in chosen)
    return tuple(discs), len(radii)


def _select_moving(excess: ExcessAcceleration) -> ExcessAcceleration:
    """Select the pieces in which a body moves."""
    moving = excess.speed > _MIN_SPEED_SHARE * excess.speed.max(initial=0.0)
    return ExcessAcceleration(
        excess.values[moving], excess.sigma[moving], excess.shot[moving], excess.t[moving], excess.position[moving],
        excess.velocity[moving],
    )  # fmt: skip


def _weigh_along(excess: ExcessAcceleration) -> tuple[FloatArray, FloatArray]:
    """Return the accelerations (M,) along the motion, and their weights (M,): of the noise, and of a usual scatter."""
    values = excess.project(excess.velocity / np.maximum(excess.speed, 1e-12)[:, None])
    scatter = np.median(np.maximum((values - np.median(values)) ** 2 - excess.sigma**2, 0.0))
    return values, np.asarray(1 / (excess.sigma**2 + scatter))


def find_local_patch(excess: ExcessAcceleration, rng: np.random.Generator) -> LocalPatch | None:
    """Find the disc with the most significant difference of the acceleration along the motion.

    Its significance follows from the same search on shuffled accelerations, its errors from a bootstrap over shots.

    Args:
        excess: Accelerations of M pieces of motion in a plane.
        rng: Random generator of the shuffles and of the bootstrap.

    Returns:
        The patch; None where no disc is significant, or where there are too few pieces.
    """
    excess = _select_moving(excess)
    if len(excess.sigma) < 4 * _MIN_INSIDE or excess.position.shape[1] != 2:
        return None
    values, weights = _weigh_along(excess)
    centres, radii, inside = _list_discs(excess.position, _RADII, _MIN_INSIDE)
    if not len(radii):
        return None
    best, largest = _most_significant(values[:, None], weights, inside)
    order = rng.permuted(np.repeat(np.arange(len(values))[:, None], _SHUFFLES, axis=1), axis=0)
    by_chance = _most_significant(values[order], weights[order], inside)[1]
    p_value = float((1 + (by_chance >= largest[0]).sum()) / (1 + _SHUFFLES))
    if p_value > PATCH_SIGNIFICANCE:
        return None
    disc = int(best[0])
    drawn = np.array(list(_draw_discs(excess, values, weights, centres, radii, inside, rng)))
    spread = np.std(drawn, axis=0) if len(drawn) > 1 else np.full(4, np.nan)
    return LocalPatch(
        centres[disc],
        float(np.hypot(spread[0], spread[1]) / np.sqrt(2)),
        float(radii[disc]),
        float(spread[2]),
        float(_difference(values, weights, inside[disc])),
        float(spread[3]),
        p_value,
    )


def _list_discs(
    position: FloatArray, shares: tuple[float, ...], least: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """List discs around pieces of motion: centres (C, 2), radii (C,), and which pieces are inside (C, M).

    The radii are `shares` of the extent; at least this number of pieces is inside, and outside.
    """
    extent = float(np.ptp(position, axis=0).max())
    apart = np.linalg.norm(position[:, None] - position[None], axis=2)
    centres, radii, inside = [], [], []
    for share in shares:
        here = apart < share * extent
        # the mean of the pieces inside is nearer to the middle of a patch than any of them
        middle = (here @ position) / here.sum(axis=1)[:, None]
        within = np.linalg.norm(middle[:, None] - position[None], axis=2) < share * extent
        count = within.sum(axis=1)
        usable = (count >= least) & (count <= len(position) - least)
        centres.append(middle[usable])
        radii.append(np.full(int(usable.sum()), share * extent))
        inside.append(within[usable])
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(inside)


def _most_significant(values: FloatArray, weights: FloatArray, inside: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the disc of largest significance (S,) and that significance (S,) for values (M, S)."""
    score = _score_discs(values, weights, inside)
    best = np.argmax(score, axis=0)
    return best, np.take_along_axis(score, best[None], axis=0)[0]


def _score_discs(values: FloatArray, weights: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the significance (C, S) of each disc for values (M, S)."""
    weights = np.broadcast_to(weights if weights.ndim == 2 else weights[:, None], values.shape)
    centred = values - (weights * values).sum(axis=0) / weights.sum(axis=0)
    part, total = inside.astype(np.float64), weights.sum(axis=0)
    own = part @ weights
    pull = part @ (weights * centred)
    # difference of the means inside and outside, over its standard deviation if every weight is right
    return np.asarray(np.abs(pull) * np.sqrt(total / np.maximum(own * (total - own), 1e-300)))


def _difference(values: FloatArray, weights: FloatArray, inside: BoolArray) -> float:
    """Return the mean of values (M,) inside minus that outside."""
    return float(np.average(values[inside], weights=weights[inside])) - float(
        np.average(values[~inside], weights=weights[~inside])
    )


def _draw_discs(
    excess: ExcessAcceleration,
    values: FloatArray,
    weights: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    inside: BoolArray,
    rng: np.random.Generator,
) -> Iterator[tuple[float, float, float, float]]:
    """Yield centre, radius and strength of the best disc of each bootstrap draw of shots."""
    shots, group = np.unique(excess.shot, return_inverse=True)
    for counts in rng.multinomial(len(shots), np.full(len(shots), 1 / len(shots)), size=_DRAWS):
        drawn = weights * counts[group]
        if ((drawn > 0) & inside).sum(axis=1).max() < _MIN_INSIDE:
            continue
        best = int(_most_significant(values[:, None], drawn, inside)[0][0])
        if drawn[inside[best]].sum() > 0 and drawn[~inside[best]].sum() > 0:
            x, y = centres[best]
            yield float(x), float(y), float(radii[best]), _difference(values, drawn, inside[best])
