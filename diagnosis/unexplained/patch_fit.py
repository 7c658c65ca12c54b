"""A patch of the plane fitted to the paths themselves, beside the effects of a simulator.

Pieces of motion propose discs; a fit of the paths from each of them decides. First only the start states follow a disc,
because those of a fit without it imitate it. Its border is wide at first, so that paths near a disc draw it to its
place, and narrow in the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_effects, fit_start_states, refit_effects
from diagnosis.unexplained.excess_acceleration import ExcessAcceleration
from diagnosis.unexplained.local_patch import PATCH_SIGNIFICANCE, Disc, LocalPatch, propose_discs
from models.core.typing import FloatArray
from models.estimation.gap_scenes.sliding_scene import GRAVITY, LOCAL_PATCH
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions
from models.numerics.statistics import correct_for_choices

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
