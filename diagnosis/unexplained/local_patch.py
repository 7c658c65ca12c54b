"""A patch of the plane in which bodies are braked more, or less, than around it.

Pieces of motion propose discs. In a scene with the generic law of a patch, a fit of the paths from each of them
decides, beside the effects of the simulator. First only the start states follow a disc, because those of a fit without
it imitate it. Its border is wide at first, so that paths near a disc draw it to its place, and narrow in the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_effects, fit_start_states, refit_effects
from diagnosis.unexplained.force_law import ExcessAcceleration
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.sliding_scene import GRAVITY, LOCAL_PATCH
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions
from models.numerics.statistics import correct_for_choices

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
    moving = excess.select(excess.speed > _MIN_SPEED_SHARE * excess.speed.max(initial=0.0))
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
    excess = excess.select(excess.speed > _MIN_SPEED_SHARE * excess.speed.max(initial=0.0))
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
    """List C discs that may be the patch, each around the mean place of neighbouring pieces of motion, M in all.

    Returns centres (C, 2), radii (C,), and which pieces are inside (C, M). The radii are `shares` of the extent of all
    pieces; at least `least` pieces are inside a disc, and outside it.
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


# Number of discs from which the paths are fitted: the pieces of a short recording place a patch within its radius.
_PROPOSALS = 4
# Number of them, of the least cost, that are fitted to the end.
_FOLLOWED = 2
# Borders of the first fits, as shares of the radius of the disc.
_WIDE_BORDERS = (0.3, 0.1)
# Iteration limits of the fits with a wide border.
_COARSE = ShootingOptions(iterations=8, shot_iterations=3)
# Iteration limits of the last fit.
_FINE = ShootingOptions(iterations=40, shot_iterations=10)
# Factors on the best radius at which everything else is fitted again: the cost is far from a parabola where another
# radius changes which paths cross the border.
_RADIUS_FACTORS = (0.75, 1.33)
# Usual radius of a patch as a share of the extent of the motion, and its relative spread: a local patch is smaller than
# the plane, and paths along one side of it hardly tell how far it reaches.
_RADIUS_SHARE, _RADIUS_SPREAD = 0.2, 0.7


@dataclass(frozen=True, slots=True)
class PatchFit:
    """A patch, and the fit with it."""

    patch: LocalPatch
    fitted: EffectFit


def fit_local_patch(
    problem: DiagnosisProblem, without: EffectFit, excess: ExcessAcceleration, rival_cost: float = np.inf
) -> PatchFit | None:
    """Fit a patch to the paths, beside the effects of another fit.

    Its significance is that of its gain over the best of the fit without it, of that fit with a generic law of
    resistance that is the same everywhere, and of a rival, corrected for the number of discs.

    Args:
        problem: Scene with the generic law `local_patch`, and priors.
        without: The fit without a patch.
        excess: Accelerations that it lacks.
        rival_cost: Cost of another fit of the same windows without a patch.

    Returns:
        The patch; None where no disc is significant, or where it leaves more than it explains.
    """
    discs, count = propose_discs(excess, _PROPOSALS)
    if not discs:
        return None
    local = _adapt_priors(problem, excess.position)
    coarse = sorted((_fit_disc(local, without, disc) for disc in discs), key=lambda one: one.cost)
    fitted = min((_narrow_border(local, one) for one in coarse[:_FOLLOWED]), key=lambda one: one.cost)
    names = (*without.names, *problem.probes)
    smooth = fit_effects(problem, without.segments, names, without.forms, without.shared, without.starts)
    gain = (min(without.cost, smooth.cost, rival_cost) - fitted.cost) / max(fitted.lack_of_fit, 1.0)
    single = float(chi2.sf(max(gain, 0.0), int(fitted.free.sum() - without.free.sum())))
    p_value = correct_for_choices(single, count)
    if p_value > PATCH_SIGNIFICANCE or without.cost - fitted.cost < fitted.lower_excess_cost:
        return None
    return PatchFit(_describe_patch(local, fitted, p_value), fitted)


def _patch_numbers(problem: DiagnosisProblem) -> list[int]:
    """Return the indices of the parameters of the patch: mu, x, y, radius, border."""
    return [int(k) for k in np.flatnonzero(problem.mask((LOCAL_PATCH.name,)))]


def _adapt_priors(problem: DiagnosisProblem, position: FloatArray) -> DiagnosisProblem:
    """Adapt the priors of a patch to the place and the extent of the motion (M, 2)."""
    priors, extent = list(problem.priors), float(np.ptp(position, axis=0).max())
    _, x, y, radius, _ = _patch_numbers(problem)
    for k, middle in zip((x, y), ((position.min(axis=0) + position.max(axis=0)) / 2).tolist(), strict=True):
        bounds = middle - 2 * extent, middle + 2 * extent
        priors[k] = replace(priors[k], value=middle, sigma=extent, bounds=bounds)
    priors[radius] = replace(
        priors[radius],
        value=_RADIUS_SHARE * extent,
        sigma=_RADIUS_SPREAD,
        relative=True,
        bounds=(1e-3 * extent, 2 * extent),
    )
    return replace(problem, priors=tuple(priors))


def _fit_disc(problem: DiagnosisProblem, without: EffectFit, disc: Disc) -> EffectFit:
    """Fit the paths from a disc, with borders that become narrower."""
    numbers = _patch_numbers(problem)
    shared, free = without.shared.copy(), without.free.copy()
    shared[numbers] = [-disc.strength / GRAVITY, *disc.centre, disc.radius, _WIDE_BORDERS[0] * disc.radius]
    free[numbers[:-1]] = True
    fitted = replace(
        without, names=(*without.names, LOCAL_PATCH.name), free=free, shared=problem.clip_to_bounds(shared)
    )
    states = fit_start_states(problem, without.segments, fitted, without.starts, retry_guesses=True)
    fitted = replace(fitted, shooting=states.shooting)
    for share in _WIDE_BORDERS:
        fitted = _refit_with_border(problem, fitted, share * disc.radius, _COARSE)
    return fitted


def _follow_states(problem: DiagnosisProblem, fitted: EffectFit, shared: FloatArray) -> EffectFit:
    """Give a fit other parameters (P,) that its start states follow; its other results are then those of the states."""
    moved = replace(fitted, shared=problem.clip_to_bounds(shared))
    states = fit_start_states(problem, fitted.segments, moved, fitted.starts, retry_guesses=True)
    return replace(moved, shooting=states.shooting)


def _profile_radius(problem: DiagnosisProblem, fitted: EffectFit) -> tuple[FloatArray, FloatArray]:
    """Fit everything but the radius at other radii: mu, x, y and radius (K, 4), and the costs (K,), the best first."""
    numbers = _patch_numbers(problem)[:-1]
    covariance, prior = _select_covariance(fitted, numbers), problem.priors[numbers[-1]]
    free = fitted.free.copy()
    free[numbers[-1]] = False
    places, costs = [fitted.shared[numbers]], [fitted.cost]
    for factor in _RADIUS_FACTORS:
        shared = fitted.shared.copy()
        shared[numbers] += covariance[:, -1] / covariance[-1, -1] * (factor - 1) * shared[numbers[-1]]
        moved = _follow_states(problem, replace(fitted, free=free), shared)
        other = _narrow_border(problem, moved)
        places.append(other.shared[numbers])
        # the prior of a fixed parameter is not in the cost
        costs.append(other.cost + (np.log(other.shared[numbers[-1]] / prior.value) / prior.sigma) ** 2)
    return np.array(places), np.array(costs)


def _select_covariance(fitted: EffectFit, numbers: list[int]) -> FloatArray:
    """Select the covariance of some of the free parameters of a fit."""
    here = np.cumsum(fitted.free)[numbers] - 1
    return np.asarray(fitted.shooting.covariance[np.ix_(here, here)])


def _narrow_border(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Refit with the usual border."""
    return _refit_with_border(problem, fitted, LOCAL_PATCH.neutral[-1], _FINE)


def _refit_with_border(
    problem: DiagnosisProblem, fitted: EffectFit, border: float, options: ShootingOptions
) -> EffectFit:
    """Refit a patch with another border (m)."""
    shared = fitted.shared.copy()
    shared[_patch_numbers(problem)[-1]] = border
    return refit_effects(problem, fitted.segments, replace(fitted, shared=shared), fitted.starts, options=options)


def _describe_patch(problem: DiagnosisProblem, fitted: EffectFit, p_value: float) -> LocalPatch:
    """Describe the patch of a fit: the mean over radii by their probability, with the larger of both errors."""
    places, costs = _profile_radius(problem, fitted)
    weights = np.exp(-0.5 * (costs - costs.min()) / fitted.lack_of_fit)
    mean = weights @ places / weights.sum()
    scatter = weights @ np.square(places - mean) / weights.sum()
    variances = np.diag(_select_covariance(fitted, _patch_numbers(problem)[:-1]))
    mu_sigma, x_sigma, y_sigma, radius_sigma = np.sqrt(np.maximum(variances, scatter)).tolist()
    return LocalPatch(
        centre=mean[1:3],
        centre_sigma=float(np.hypot(x_sigma, y_sigma) / np.sqrt(2)),
        radius=float(mean[3]),
        radius_sigma=radius_sigma,
        strength=-GRAVITY * float(mean[0]),
        strength_sigma=GRAVITY * mu_sigma,
        p_value=p_value,
    )
