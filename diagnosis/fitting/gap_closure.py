"""How far the gap shrinks: the error of predictions with and without the effects, and the noise floor.

The floor is the error of a right model from the same start: measurement noise, and the error of the start as it grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from diagnosis.fitting.prediction_windows import (
    Predictions,
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

    before: float
    """rms distance between prediction and observation, without the effects."""
    after: float
    """The same with the effects."""
    floor: float
    """The same for a right model from the same starts; NaN where the noise is unknown."""
    closed: float
    """(before^2 - after^2) / (before^2 - floor^2), clipped to [-1, 1]; NaN where it is not resolved."""
    interval: tuple[float, float]
    """95 % interval of `closed`."""
    resolved: bool
    """Whether the gap before exceeds the noise."""
    most_probability: float = float("nan")
    """Probability that more than half of the gap is closed; NaN where it is not resolved."""


def estimate_noise_floor(
    problem: DiagnosisProblem, windows: tuple[PredictionWindow, ...], like: EffectFit, predictions: Predictions
) -> FloatArray:
    """Estimate the squared error that a right model would have from the start states of the better model.

    It is the sum of the noise and the effect of the start errors. Start errors are measured with a fit of the whole
    window. A wrong model would count its own error as a start error, so that no more is allowed than chance explains.

    Args:
        problem: Scene and priors.
        windows: W prediction windows.
        like: Fit of the better model.
        predictions: Predictions of the better model.

    Returns:
        (W,) sum of squared errors of each window.
    """
    if not windows:
        return np.zeros(0)
    whole = fit_start_states(problem, tuple(one.segment for one in windows), like, predictions.starts)
    off, surprise, free = np.zeros(len(windows)), 0.0, 0
    for k, one in enumerate(windows):
        path = problem.scene.predict_positions(one.segment, whole.starts[k], like.shared, like.forms)
        off[k] = sum_squared_errors(one, predictions.paths[k] - path)
        one_surprise, one_free = start_error_chi2(
            whole.starts[k] - predictions.starts[k], predictions.covariances[k], whole.noise_start_covariances[k]
        )
        surprise, free = surprise + one_surprise, free + one_free
    granted = min(1.0, float(chi2.ppf(_START_ERROR_PROBABILITY, free)) / surprise) if surprise > 0 else 1.0
    coordinates = predictions.paths[0].shape[2]
    noise = [
        coordinates * float(np.square(w.segment.sigma[w.start_rows :][w.segment.is_observed[w.start_rows :]]).sum())
        for w in windows
    ]
    least = granted * off + np.array(noise)
    # the error of the right model is at most that of this one
    return np.asarray(least * min(1.0, float(predictions.squares.sum()) / max(float(least.sum()), 1e-300)))


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


def count_predictions(windows: tuple[PredictionWindow, ...]) -> FloatArray:
    """Count the predicted observations (W,) of each window."""
    return np.array([one.segment.is_observed[one.start_rows :].sum() for one in windows], dtype=np.float64)


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
    count = count_predictions(windows)
    if not count.sum():
        return GapClosure(float("nan"), float("nan"), float("nan"), float("nan"), (float("nan"), float("nan")), False)
    total = count.sum()
    b, a, f = (float(one.sum() / total) for one in (before, after, floor))
    if np.isnan(f):
        return GapClosure(_root(b), _root(a), float("nan"), float("nan"), (-1.0, 1.0), False)
    drawn = _draw_bootstrap_weights(windows, rng)
    excess = drawn @ (before - floor)
    resolved = bool(np.quantile(drawn @ (before - _NOISE_MARGIN * floor), _INTERVAL_QUANTILES[0]) > 0)
    if not resolved:
        return GapClosure(_root(b), _root(a), _root(f), float("nan"), (-1.0, 1.0), False)
    closed = float(np.clip((b - a) / (b - f), -limit, limit))
    excess = excess + (drawn @ floor) * (_NOISE_MARGIN - 1) / 2 * rng.standard_normal(len(drawn))
    ratios = np.clip(drawn @ (before - after) / np.maximum(excess, 1e-300), -limit, limit)
    low, high = np.quantile(ratios, _INTERVAL_QUANTILES)
    interval = (min(float(low), closed), max(float(high), closed))
    # with few blocks the next one may differ from all of them: Laplace's rule of succession
    most = (float((ratios > 0.5).mean()) * _count_blocks(windows) + 1) / (_count_blocks(windows) + 2)
    return GapClosure(_root(b), _root(a), _root(f), closed, interval, True, most)


def _root(square: float) -> float:
    """Take the square root of a mean square."""
    return float(np.sqrt(max(square, 0.0)))


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


def _count_blocks(windows: tuple[PredictionWindow, ...]) -> int:
    """Count the blocks of windows."""
    return len(_group_into_blocks(windows))


def measure_closure(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    base: EffectFit,
    better: EffectFit,
    rng: np.random.Generator,
) -> GapClosure:
    """Measure how much of the gap a better model closes on recordings that it was not fitted to.

    Args:
        problem: Scene and priors.
        recordings: Other shots, with the noise estimate applied.
        base: Fit of the simulator.
        better: Fit of the better model.
        rng: Random generator.

    Returns:
        The closure.
    """
    foreseen = select_predictable(problem, build_prediction_windows(problem, recordings), better, rng)
    windows = foreseen.windows
    before, after = (predict_windows(problem, windows, one, foreseen.starts) for one in (base, better))
    return estimate_closure(
        windows, before.squares, after.squares, estimate_noise_floor(problem, windows, better, after), rng
    )


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
