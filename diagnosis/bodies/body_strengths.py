"""Strengths that differ between bodies: whether they do, and the strength of each body under a common prior.

In a scene without contacts every body moves on its own, so that a strength of each body can be fitted together with all
that the bodies share. Whether the strengths differ is Cochran's test between bodies. The scatter of one body's shots
counts as an error, or shots that differ would make bodies differ. The common prior is normal; its mean and width come
from the bodies themselves (empirical Bayes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.fit_residuals import FitResiduals, compute_residuals
from diagnosis.fitting.gap_closure import GapClosure, estimate_closure, estimate_noise_floor
from diagnosis.fitting.hypothesis_fits import (
    FULL_FIT,
    DiagnosisProblem,
    EffectFit,
    LinearizedFit,
    build_window_model,
    linearize_fit,
)
from diagnosis.fitting.prediction_windows import (
    Predictions,
    PredictionWindow,
    build_prediction_windows,
    predict_windows,
    select_predictable,
)
from diagnosis.fitting.strength_scatter import estimate_shot_steps, measure_scatter
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.multiple_shooting.fitted_parameters import FittedModel
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, fit_windows
from models.physics.effect import Prior

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
    starts: tuple[FloatArray, ...]
    """Start state (S,) of each window."""
    lack_of_fit: float
    """Factor >= 1 by which the variance of the residuals exceeds that of the noise."""
    cost: float
    """Robust chi2 of the residuals and priors."""
    parameter_count: int
    """Number of fitted parameters, common and own."""

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
    together = _fit_bodies(problem, fitted, bodies, segments, alone.starts, own, priors)
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
    options = replace(FULL_FIT, is_smooth=problem.is_smooth)
    shooting: ShootingFit = fit_windows(model, first, options, starts, executor=problem.executor)
    values = np.stack([model.fill_values(k, shooting.shared) for k in range(len(bodies))])
    sigma = np.full(values.shape, np.nan)
    sigma[:, own] = shooting.sigma[int(common.sum()) :].reshape(len(bodies), size)
    nothing = np.zeros(len(own))
    return BodyFit(
        bodies=bodies,
        own=own,
        shared=values,
        sigma=sigma,
        centre=like.shared,
        spread=nothing,
        shot_spread=nothing,
        segments=segments,
        starts=shooting.starts,
        lack_of_fit=shooting.inflation,
        cost=shooting.cost,
        parameter_count=len(first),
    )


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
    shooting = replace(like.shooting, starts=tuple(body_fit.starts[k] for k in here))
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
            steps, weights = estimate_shot_steps(shots, int(k), alone.lack_of_fit)
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
    """Linearise the windows of every body at its own strengths.

    Args:
        problem: Scene and priors.
        like: Fit with strengths that all bodies share.
        body_fit: Fit with strengths of every body.

    Returns:
        Fit and linearisation per body, in the order of `body_fit.bodies`.
    """
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
    first_windows = np.cumsum([0, *(len(fitted.segments) for fitted, _ in bodies)])
    counts = np.array([one.values.size for one in parts])
    scale = float(np.sqrt(counts @ np.square([one.scale for one in parts]) / counts.sum()))
    images = [one.image for one in parts if one.image is not None]
    return replace(
        parts[0],
        values=np.concatenate([one.values * one.scale / scale for one in parts]),
        noise_draws=np.concatenate([one.noise_draws for one in parts]),
        window=np.concatenate([one.window + first for one, first in zip(parts, first_windows[:-1], strict=True)]),
        shot=np.concatenate([one.shot for one in parts]),
        body=np.concatenate([one.body for one in parts]),
        frame=np.concatenate([one.frame for one in parts]),
        t=np.concatenate([one.t for one in parts]),
        phase=np.concatenate([one.phase for one in parts]),
        position=np.concatenate([one.position for one in parts]),
        velocity=np.concatenate([one.velocity for one in parts]),
        since_contact=np.concatenate([one.since_contact for one in parts]),
        image=np.concatenate(images) if len(images) == len(parts) else None,
        scale=scale,
    )


def predict_bodies(
    problem: DiagnosisProblem,
    windows: tuple[PredictionWindow, ...],
    like: EffectFit,
    body_fit: BodyFit,
    starts: tuple[FloatArray, ...],
) -> tuple[Predictions, FloatArray]:
    """Predict windows, each with the strengths of its body.

    Args:
        problem: Scene and priors.
        windows: W prediction windows, of one body each; an unknown body has the mean strengths of all.
        like: Fit with strengths that all bodies share.
        body_fit: Fit with strengths of every body.
        starts: Start state (S,) of each window, as an initial guess.

    Returns:
        Predictions of all windows, and (W,) the sum of squared errors that a right model would have.
    """
    names = [one.segment.bodies[0] for one in windows]
    parts: dict[int, tuple[FloatArray, FloatArray, FloatArray, float, float]] = {}
    for body in sorted(set(names)):
        here = [k for k, name in enumerate(names) if name == body]
        own = replace(like, shared=body_fit.values_of(body))
        its_windows = tuple(windows[k] for k in here)
        predicted = predict_windows(problem, its_windows, own, tuple(starts[k] for k in here))
        floor = estimate_noise_floor(problem, its_windows, own, predicted)
        for place, k in enumerate(here):
            parts[k] = (
                predicted.starts[place],
                predicted.covariances[place],
                predicted.paths[place],
                float(predicted.squares[place]),
                float(floor[place]),
            )
    ordered = [parts[k] for k in range(len(windows))]
    predictions = Predictions(
        tuple(one[0] for one in ordered),
        tuple(one[1] for one in ordered),
        tuple(one[2] for one in ordered),
        np.array([one[3] for one in ordered]),
    )
    return predictions, np.array([one[4] for one in ordered])


def measure_body_closure(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    base: EffectFit,
    better: EffectFit,
    body_fit: BodyFit,
    rng: np.random.Generator,
) -> GapClosure:
    """Measure how much of the gap strengths of every body close on recordings that they were not fitted to.

    Args:
        problem: Scene and priors.
        recordings: Other shots, with the noise estimate applied.
        base: Fit of the simulator.
        better: Fit with strengths that all bodies share.
        body_fit: Fit with strengths of every body.
        rng: Random generator.

    Returns:
        The closure.
    """
    predictable = select_predictable(problem, build_prediction_windows(problem, split_bodies(recordings)), better, rng)
    windows = predictable.windows
    before = predict_windows(problem, windows, base, predictable.starts)
    after, floor = predict_bodies(problem, windows, better, body_fit, predictable.starts)
    return estimate_closure(windows, before.squares, after.squares, floor, rng)
