"""How far the gap shrinks: the error of predictions with and without the effects, and the noise floor.

The floor is the error of a right model from the same start: measurement noise, and the error of the start as it grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.body_strengths import BodyFit, split_bodies
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from diagnosis.fitting.prediction_windows import (
    Prediction,
    PredictionWindow,
    build_prediction_windows,
    predict_windows,
    select_predictable,
    sum_squared_errors,
)
from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray

# Ratio to the squares of the floor from which an error exceeds noise: two standard deviations of its estimate.
_NOISE_MARGIN = 1.15
# Ratio of an error to the attainable one from which it is clearly more than noise: three quarters of the squared error
# are then no noise.
CLEAR_TIMES_FLOOR = 2.0
# Ratio of the floor of a window to the median one from which it is left out: it would weigh as much as 16 others.
_MAX_FLOOR_RATIO = 4.0
# Number of bootstrap samples.
_BOOTSTRAP_DRAWS = 2000
# Quantile up to which the error of the starts may be chance.
_START_ERROR_PROBABILITY = 0.9
# Number of shots from which shots are drawn in a bootstrap, not windows.
_MIN_SHOT_BLOCKS = 6
# Share of the variance of a start that a fit of the whole window must remove for the difference to be its error.
_MIN_VARIANCE_REDUCTION = 0.5
# Quantiles of reported intervals.
_INTERVAL_QUANTILES = (0.025, 0.975)


@dataclass(frozen=True, slots=True)
class GapClosure:
    """How much of the gap one model closes relative to another."""

    before: float = float("nan")
    """rms distance between prediction and observation, without the effects."""
    after: float = float("nan")
    """The same with the effects."""
    floor: float = float("nan")
    """The same for a right model from the same starts; NaN where the noise is unknown."""
    closed: float = float("nan")
    """(before^2 - after^2) / (before^2 - floor^2), clipped to [-1, 1]; NaN where it is not resolved."""
    interval: tuple[float, float] = (-1.0, 1.0)
    """95 % interval of `closed`."""
    resolved: bool = False
    """Whether the gap before exceeds the noise."""
    most_probability: float = float("nan")
    """Probability that more than half of the gap is closed; NaN where it is not resolved."""
    is_absent: bool = False
    """Whether the error before is surely not clearly larger than that of a right model."""


UNKNOWN_CLOSURE = GapClosure()


@dataclass(frozen=True, slots=True)
class PredictedShots:
    """W windows of hold-out shots, and their predictions by two models."""

    windows: tuple[PredictionWindow, ...]
    before: tuple[Prediction, ...]
    after: tuple[Prediction, ...]
    floor: FloatArray
    """(W,) sum of squared errors of a right model."""


def predict_shots(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    base: EffectFit,
    better: EffectFit,
    rng: np.random.Generator,
    body_fit: BodyFit | None = None,
) -> PredictedShots:
    """Predict shots that two models were not fitted to.

    Windows in which a right model too would be far off, as near a point where the motion is unstable, are left out.

    Args:
        problem: Scene and priors.
        recordings: Other shots, with the noise estimate applied.
        base: Fit of the simulator.
        better: Fit of the better model.
        rng: Random generator of the sampled starts.
        body_fit: The better model with strengths of every body, where they differ; an unknown body has the mean
            strengths of all.

    Returns:
        The predictions.
    """
    recordings = recordings if body_fit is None else split_bodies(recordings)
    windows = select_predictable(problem, build_prediction_windows(problem, recordings), better, rng)
    after, floor = list[Prediction | None]([None] * len(windows)), np.zeros(len(windows))
    bodies = [one.segment.bodies[0] if body_fit is not None else "" for one in windows]
    for body in sorted(set(bodies)):
        here = [k for k, name in enumerate(bodies) if name == body]
        own_windows = tuple(windows[k] for k in here)
        own = better if body_fit is None else replace(better, shared=body_fit.values_of(body))
        predictions = predict_windows(problem, own_windows, own)
        floor[here] = _estimate_noise_floor(problem, own_windows, own, predictions)
        for k, one in zip(here, predictions, strict=True):
            after[k] = one
    counts = np.array([max(int(one.is_predicted.sum()), 1) for one in windows])
    limit = _MAX_FLOOR_RATIO**2 * np.median(floor / counts) if len(windows) else 0.0
    chosen = np.flatnonzero(~(floor / counts > limit))
    windows = tuple(windows[k] for k in chosen)
    better_predictions = tuple(one for one in (after[k] for k in chosen) if one is not None)
    return PredictedShots(windows, predict_windows(problem, windows, base), better_predictions, floor[chosen])


def sum_squares(predictions: tuple[Prediction, ...]) -> FloatArray:
    """Return the sum of squared errors (W,) of each prediction."""
    return np.array([one.square for one in predictions])


def _estimate_noise_floor(
    problem: DiagnosisProblem,
    windows: tuple[PredictionWindow, ...],
    like: EffectFit,
    predictions: tuple[Prediction, ...],
) -> FloatArray:
    """Estimate the squared error (W,) that a right model would have from the start states of the better model.

    It is the sum of the noise and the effect of the start errors. Start errors are measured with a fit of the whole
    window. A wrong model would count its own error as a start error, so that no more is allowed than chance explains.
    """
    whole = fit_start_states(
        problem, tuple(one.segment for one in windows), like, tuple(one.start for one in predictions)
    )
    off, noise, surprise, free = np.zeros(len(windows)), np.zeros(len(windows)), 0.0, 0
    for k, (one, predicted) in enumerate(zip(windows, predictions, strict=True)):
        path = problem.scene.predict_positions(one.segment, whole.starts[k], like.shared, like.forms)
        off[k] = sum_squared_errors(one, predicted.path - path)
        noise[k] = path.shape[2] * float(np.square(one.segment.sigma[one.is_predicted]).sum())
        one_surprise, one_free = start_error_chi2(
            whole.starts[k] - predicted.start, predicted.covariance, whole.noise_start_covariances[k]
        )
        surprise, free = surprise + one_surprise, free + one_free
    granted = min(1.0, float(chi2.ppf(_START_ERROR_PROBABILITY, free)) / surprise) if surprise > 0 else 1.0
    least = granted * off + noise
    # the error of the right model is at most that of this one
    return np.asarray(least * min(1.0, float(sum_squares(predictions).sum()) / max(float(least.sum()), 1e-300)))


def start_error_chi2(step: FloatArray, covariance: FloatArray, better_covariance: FloatArray) -> tuple[float, int]:
    """Return chi2 of a step (S,) from one start state to a better one, and its number of directions.

    Only directions count in which the better start is so much better known that the step is the error of the first.
    Elsewhere both depend on the same rows, and the expected step is a difference of two estimated covariances.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    sizes, axes = np.linalg.eigh(covariance * scale * scale[:, None])
    resolved = sizes > 1e-9 * sizes[-1]
    white = (axes[:, resolved] / np.sqrt(sizes[resolved])).T * scale
    gained, turn = np.linalg.eigh(white @ (covariance - better_covariance) @ white.T)
    improved = gained > _MIN_VARIANCE_REDUCTION
    return float((np.square(turn.T @ white @ step)[improved] / gained[improved]).sum()), int(improved.sum())


def estimate_closure(
    windows: tuple[PredictionWindow, ...],
    before: FloatArray,
    after: FloatArray,
    floor: FloatArray,
    rng: np.random.Generator,
    limit: float = 1.0,
) -> GapClosure:
    """Estimate the closed part of the gap and its interval, by a block bootstrap over shots or windows.

    Args:
        windows: W prediction windows.
        before: (W,) sum of squared errors without the effects.
        after: (W,) sum of squared errors with the effects.
        floor: (W,) sum of squared errors of a right model.
        rng: Random generator of the bootstrap.
        limit: The closed part is clipped to -`limit` and `limit`; one of several effects may close more than the whole.

    Returns:
        The closure; NaN where there is nothing to predict or the gap is not resolved.
    """
    total = sum(int(one.is_predicted.sum()) for one in windows)
    if not total:
        return UNKNOWN_CLOSURE
    b, a, f = (float(one.sum() / total) for one in (before, after, floor))
    rms_before, rms_after, rms_floor = (float(np.sqrt(max(square, 0.0))) for square in (b, a, f))
    if np.isnan(f):
        return GapClosure(rms_before, rms_after)
    drawn = _draw_bootstrap_weights(windows, rng)
    if not np.quantile(drawn @ (before - _NOISE_MARGIN * floor), _INTERVAL_QUANTILES[0]) > 0:
        is_absent = bool(np.quantile(drawn @ (before - CLEAR_TIMES_FLOOR**2 * floor), _INTERVAL_QUANTILES[1]) < 0)
        return GapClosure(rms_before, rms_after, rms_floor, is_absent=is_absent)
    closed = float(np.clip((b - a) / (b - f), -limit, limit))
    excess = drawn @ (before - floor) + (drawn @ floor) * (_NOISE_MARGIN - 1) / 2 * rng.standard_normal(len(drawn))
    ratios = np.clip(drawn @ (before - after) / np.maximum(excess, 1e-300), -limit, limit)
    low, high = np.quantile(ratios, _INTERVAL_QUANTILES)
    interval = (min(float(low), closed), max(float(high), closed))
    # with few blocks the next one may differ from all of them: Laplace's rule of succession
    blocks = len(_group_into_blocks(windows))
    most = (float((ratios > 0.5).mean()) * blocks + 1) / (blocks + 2)
    return GapClosure(rms_before, rms_after, rms_floor, closed, interval, True, most)


def _draw_bootstrap_weights(windows: tuple[PredictionWindow, ...], rng: np.random.Generator) -> FloatArray:
    """Draw bootstrap weights (draws, W) of windows, by shots where there are at least six, else by windows."""
    groups = _group_into_blocks(windows)
    counts = rng.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), size=_BOOTSTRAP_DRAWS)
    weights = np.zeros((_BOOTSTRAP_DRAWS, len(windows)))
    for group, drawn in zip(groups, counts.T, strict=True):
        weights[:, group] = drawn[:, None]
    return weights


def _group_into_blocks(windows: tuple[PredictionWindow, ...]) -> list[IntArray]:
    """Group the numbers of windows into blocks that vary independently: shots where there are at least six."""
    shots = np.array([one.segment.shot for one in windows])
    numbers = np.unique(shots)
    if len(numbers) >= _MIN_SHOT_BLOCKS:
        return [np.flatnonzero(shots == n) for n in numbers]
    return [np.array([k]) for k in range(len(shots))]


def measure_closure(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    base: EffectFit,
    better: EffectFit,
    rng: np.random.Generator,
    body_fit: BodyFit | None = None,
) -> GapClosure:
    """Measure how much of the gap a better model closes on shots that it was not fitted to, as `predict_shots`."""
    shots = predict_shots(problem, recordings, base, better, rng, body_fit)
    return estimate_closure(shots.windows, sum_squares(shots.before), sum_squares(shots.after), shots.floor, rng)


def shapley_shares(
    names: tuple[str, ...], squares_with: Callable[[frozenset[str]], FloatArray]
) -> dict[str, FloatArray]:
    """Return the part of each effect in the squared error that all of them remove, by Shapley's value (1953).

    Args:
        names: Effects.
        squares_with: Function from a set of effects to (W,) squared errors of predictions with them.

    Returns:
        (W,) for each effect.
    """
    parts = {}
    for name in names:
        others = [other for other in names if other != name]
        part: FloatArray = np.zeros(0)
        for size in range(len(names)):
            weight = factorial(size) * factorial(len(names) - size - 1) / factorial(len(names))
            for chosen in combinations(others, size):
                gained = squares_with(frozenset(chosen)) - squares_with(frozenset((*chosen, name)))
                part = weight * gained if part.size == 0 else part + weight * gained
        parts[name] = part
    return parts
