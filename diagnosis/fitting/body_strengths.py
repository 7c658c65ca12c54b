"""Strengths that differ between bodies: whether they do, and the strength of each body under a common prior.

In a scene without contacts every body moves on its own, so that a strength of each body can be fitted together with all
that the bodies share. Cochran's test between bodies decides whether the strengths differ; their variance beyond their
errors is estimated as by DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2. The scatter of one body's shots
counts as an error, or shots that differ would make bodies differ. The common prior is normal; its mean and width come
from the bodies themselves (empirical Bayes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.fit_residuals import FitResiduals, compute_residuals, concatenate_residuals
from diagnosis.fitting.hypothesis_fits import (
    FULL_FIT,
    DiagnosisProblem,
    EffectFit,
    LinearizedFit,
    ShotInformation,
    build_window_model,
    linearize_fit,
)
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, fit_windows
from models.estimation.multiple_shooting.shooting_windows import FittedModel
from models.physics.effect import Prior

# Information of a shot over that of the best one, below which it says nothing of a strength.
_MIN_INFORMATION = 1e-6


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of estimates about their mean."""

    mean: float
    square: float
    """Sum of the squared deviations from the mean, in squared errors."""
    freedom: int
    """Number of estimates less 1."""
    scale: float
    """What one unit of variance between the estimates adds to `square` on average."""

    @property
    def p_value(self) -> float:
        """Probability of such a scatter where the estimates differ by their errors alone."""
        return float(chi2.sf(self.square, self.freedom))

    @property
    def variance(self) -> float:
        """Variance of the strength beyond the errors; negative by chance where there is none."""
        return (self.square - self.freedom) / self.scale


def measure_scatter(values: FloatArray, weights: FloatArray) -> Scatter:
    """Measure the scatter of estimates.

    Args:
        values: (N,) estimates.
        weights: (N,) inverse squares of their errors.

    Returns:
        The scatter.
    """
    total = float(weights.sum())
    mean = float(weights @ values) / total
    square = float(weights @ np.square(values - mean))
    return Scatter(mean, square, len(values) - 1, total - float(np.square(weights).sum()) / total)


def estimate_shot_steps(
    shot_information: ShotInformation, parameter: int, lack_of_fit: float
) -> tuple[FloatArray, FloatArray]:
    """Estimate by how much each shot alone would change a fitted strength: one Newton step from the fit to all shots.

    Args:
        shot_information: Information of each shot.
        parameter: Index of the strength.
        lack_of_fit: Factor by which the variance of the residuals exceeds that of the noise.

    Returns:
        (N,) steps and (N,) their weights, of the shots that say something of the strength.
    """
    information = shot_information.information[:, parameter, parameter]
    usable = information > _MIN_INFORMATION * information.max(initial=0.0)
    return shot_information.score[usable, parameter] / information[usable], information[usable] / lack_of_fit


# p-value of equal strengths of all bodies below which they differ.
DIFFERENCE_P_VALUE = 0.005


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Fit of B bodies with strengths of their own; P parameters of the catalogue."""

    bodies: tuple[str, ...]
    """B names."""
    own: BoolArray
    """(P,) parameters that differ between bodies."""
    shared: FloatArray
    """(B, P) values of all parameters for each body."""
    sigma: FloatArray
    """(B, P) standard deviations; NaN for parameters that do not differ."""
    centre: FloatArray
    """(P,) values for a body that was never observed: the mean of the common prior."""
    spread: FloatArray
    """(P,) standard deviation between bodies, the width of the common prior; 0 where they do not differ."""
    shot_spread: FloatArray
    """(P,) standard deviation between shots of one body; 0 where they may all have the same."""
    segments: tuple[Recording, ...]
    """Windows, of one body each, body by body."""
    shooting: ShootingFit
    """The fit of all windows."""

    def values_of(self, body: str) -> FloatArray:
        """Return the values (P,) of all parameters for a body; those of the common prior for an unknown one."""
        return self.shared[self.bodies.index(body)] if body in self.bodies else self.centre


def split_bodies(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Split recordings into recordings of one body each.

    Args:
        recordings: Recordings of one or several bodies.

    Returns:
        One recording per recording and body; bodies that were never observed are left out.
    """
    return tuple(
        one.select_body(body) for one in recordings for body in range(len(one.bodies)) if one.is_observed[:, body].any()
    )


def fit_body_strengths(
    problem: DiagnosisProblem, fitted: EffectFit, differing: BoolArray | None = None
) -> BodyFit | None:
    """Fit the missing effects of a hypothesis with strengths of every body, where they differ.

    Args:
        problem: Scene and priors.
        fitted: Fit with strengths that all bodies share.
        differing: (P,) parameters that are known to differ between bodies; where not given, it is tested.

    Returns:
        The fit; None where all bodies may have the same strengths, or the shots cannot tell bodies from shots.
    """
    tested = np.ones(len(fitted.free), bool) if differing is None else differing
    candidates = tested & problem.mask(tuple(name for name in fitted.names if name in problem.candidates)) & fitted.free
    bodies = tuple(sorted({name for segment in fitted.segments for name in segment.bodies}))
    if not isinstance(problem.scene, ContactFreeScene) or not candidates.any() or len(bodies) < 2:
        return None
    parts = [
        (segment.select_body(k), start)
        for segment, starts in zip(fitted.segments, fitted.starts, strict=True)
        for k, start in enumerate(np.split(starts, len(segment.bodies)))
    ]
    parts.sort(key=lambda part: part[0].bodies)
    segments, starts = tuple(segment for segment, _ in parts), tuple(start for _, start in parts)
    if differing is None and len({(segment.shot, segment.bodies) for segment in segments}) == len(bodies):
        return None
    alone = _fit_bodies(problem, fitted, bodies, segments, starts, candidates, problem.priors)
    shot_spread, added = _estimate_shot_scatter(problem, fitted, alone, candidates)
    errors = np.sqrt(np.square(alone.sigma) + added)
    centre, spread = fitted.shared.copy(), np.zeros(len(fitted.shared))
    for k in np.flatnonzero(candidates):
        centre[k], spread[k] = estimate_common_prior(alone.shared[:, k], errors[:, k])
    own = spread > 0
    if not own.any():
        return None
    priors = tuple(
        replace(prior, value=float(np.clip(centre[k], *prior.bounds)), sigma=float(spread[k])) if own[k] else prior
        for k, prior in enumerate(problem.priors)
    )
    together = _fit_bodies(problem, fitted, bodies, segments, alone.shooting.starts, own, priors)
    unobserved = np.where(own, centre, together.shared[0])
    sigma = np.where(own, np.sqrt(np.square(together.sigma) + added), np.nan)
    return replace(
        together, own=own, sigma=sigma, centre=unobserved, spread=spread, shot_spread=np.where(own, shot_spread, 0.0)
    )


def estimate_common_prior(values: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Estimate mean and width of the distribution of a strength between bodies.

    Args:
        values: (B,) strengths.
        errors: (B,) their standard deviations.

    Returns:
        Mean and standard deviation; the latter is 0 where the strengths do not differ clearly.
    """
    scatter = measure_scatter(values, 1 / np.square(errors))
    if scatter.p_value >= DIFFERENCE_P_VALUE:
        return scatter.mean, 0.0
    weights = 1 / (np.square(errors) + scatter.variance)
    return float(weights @ values / weights.sum()), float(np.sqrt(scatter.variance))


def _fit_bodies(
    problem: DiagnosisProblem,
    like: EffectFit,
    bodies: tuple[str, ...],
    segments: tuple[Recording, ...],
    starts: tuple[FloatArray, ...],
    own: BoolArray,
    priors: tuple[Prior, ...],
) -> BodyFit:
    """Fit the parameters of `own` for every body, and the other free ones of `like` for all."""
    common, size = like.free & ~own, int(own.sum())
    body: IntArray = np.array([bodies.index(segment.bodies[0]) for segment in segments], np.int64)
    shared_priors = tuple(prior for prior, is_common in zip(problem.priors, common, strict=True) if is_common)
    own_priors = tuple(prior for prior, is_own in zip(priors, own, strict=True) if is_own)
    model = FittedModel(
        build_window_model(problem, segments, like.forms, like.free),
        like.shared,
        common,
        own,
        body,
        (*shared_priors, *own_priors * len(bodies)),
    )
    first = np.concatenate([like.shared[common], np.tile(like.shared[own], len(bodies))])
    options = problem.fit_options(FULL_FIT)
    shooting = fit_windows(model, first, options, starts, executor=problem.executor)
    values = np.stack([model.fill_values(k, shooting.shared) for k in range(len(bodies))])
    sigma = np.full(values.shape, np.nan)
    sigma[:, own] = shooting.sigma[int(common.sum()) :].reshape(len(bodies), size)
    none = np.zeros(len(own))
    return BodyFit(bodies, own, values, sigma, like.shared, none, none, segments, shooting)


def select_body_fit(like: EffectFit, body_fit: BodyFit, body: str) -> EffectFit:
    """Select the windows and the parameters of one body of a fit.

    Args:
        like: Fit with strengths that all bodies share.
        body_fit: Fit with strengths of every body.
        body: Name of the body.

    Returns:
        The fit of its windows; covariances are those of `like`.
    """
    here = [k for k, segment in enumerate(body_fit.segments) if segment.bodies == (body,)]
    shooting = replace(like.shooting, starts=tuple(body_fit.shooting.starts[k] for k in here))
    return replace(
        like, segments=tuple(body_fit.segments[k] for k in here), shared=body_fit.values_of(body), shooting=shooting
    )


def _estimate_shot_scatter(
    problem: DiagnosisProblem, like: EffectFit, alone: BodyFit, candidates: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Estimate the standard deviation (P,) of strengths between shots of one body, 0 where it is not clear.

    Also return the variance (B, P) that this scatter, clear or not, adds to the mean strength of each body.
    """
    size = len(candidates)
    scatter, more, scale, shares = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros((len(alone.bodies), size))
    for number, body in enumerate(alone.bodies):
        shots = linearize_fit(problem, select_body_fit(like, alone, body)).shot_information
        for k in np.flatnonzero(candidates):
            steps, weights = estimate_shot_steps(shots, int(k), alone.shooting.inflation)
            if not len(steps):
                continue
            one = measure_scatter(steps, weights)
            scatter[k] += one.square
            more[k] += one.freedom
            scale[k] += one.scale
            shares[number, k] = float(np.square(weights).sum() / weights.sum() ** 2)
    variance = np.where(scale > 0, np.maximum(scatter - more, 0.0) / np.where(scale > 0, scale, 1.0), 0.0)
    is_clear = chi2.sf(scatter, np.maximum(more, 1)) < DIFFERENCE_P_VALUE
    return np.where(is_clear, np.sqrt(variance), 0.0), variance * shares


def linearize_bodies(
    problem: DiagnosisProblem, like: EffectFit, body_fit: BodyFit
) -> tuple[tuple[EffectFit, LinearizedFit], ...]:
    """Linearise the windows of every body at its own strengths, with the fit of each; `like` shares its strengths."""
    fits = (select_body_fit(like, body_fit, body) for body in body_fit.bodies)
    return tuple((fitted, linearize_fit(problem, fitted)) for fitted in fits)


def compute_body_residuals(
    problem: DiagnosisProblem, bodies: tuple[tuple[EffectFit, LinearizedFit], ...], rng: np.random.Generator
) -> FitResiduals:
    """Compute the residuals of all windows of a `BodyFit`, in its order; or those of one fit of all bodies.

    Args:
        problem: Scene and noise.
        bodies: Fit and linearisation per body.
        rng: Random generator of the noise.

    Returns:
        Residuals of all observations; with several fits, `body` is 0 throughout, as a window has one body.
    """
    parts = [compute_residuals(problem, fitted, linearized, rng) for fitted, linearized in bodies]
    if len(parts) == 1:
        return parts[0]
    counts = np.array([one.values.size for one in parts])
    scale = float(np.sqrt(counts @ np.square([one.scale for one in parts]) / counts.sum()))
    firsts = np.cumsum([0, *(len(fitted.segments) for fitted, _ in bodies)])
    return concatenate_residuals(
        [
            replace(one, values=one.values * one.scale / scale, window=one.window + first, scale=scale)
            for one, first in zip(parts, firsts[:-1], strict=True)
        ]
    )
