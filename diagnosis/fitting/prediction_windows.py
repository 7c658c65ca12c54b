"""Windows of hold-out shots, and open-loop predictions of them.

A prediction starts from a fit of the first frames of a window and does not use later ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.fitting.diagnosis_windows import MIN_ROWS, add_rest_observations, split_into_segments
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import ContactRichScene, PartlyObservedScene

# Frames from which the start state is fitted.
START_FRAMES = 15
# Duration of an open-loop prediction, s.
HORIZON_S = 0.85
# Frames from which the start state is fitted in shots that are too short for START_FRAMES.
_MIN_START_FRAMES = 6
# Number of sampled starts that decide what can be predicted.
_START_SAMPLES = 24
# Largest spread of predictions due to their starts, relative to the error of the better model.
_MAX_START_SPREAD = 4.0


@dataclass(frozen=True, slots=True)
class PredictionWindow:
    """A segment to predict: the start is fitted to its first `start_rows` rows, the others are predicted."""

    segment: Recording
    start_rows: int
    start: FloatArray | None = None
    """(S,) start state from an earlier fit, as an initial guess."""

    @property
    def is_predicted(self) -> BoolArray:
        """(T, N) whether an observation is predicted."""
        later = self.segment.is_observed.copy()
        later[: self.start_rows] = False
        return later


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction of a window by one model."""

    start: FloatArray
    """(S,) start state, fitted to the first rows."""
    covariance: FloatArray
    """(S, S) of the start, from the noise of the observations alone."""
    path: FloatArray
    """(T, N, D) predicted positions."""
    square: float
    """Sum of squared errors over the predicted observations."""


def build_prediction_windows(
    problem: DiagnosisProblem, recordings: tuple[Recording, ...]
) -> tuple[PredictionWindow, ...]:
    """Build prediction windows of hold-out shots, half a window apart.

    Args:
        problem: Scene and priors.
        recordings: Hold-out shots, with the noise estimate applied.

    Returns:
        Windows in which every body is observed, or known to rest, at the start and something moves.
    """
    windows = []
    for segment in split_into_segments(problem, recordings):
        start_rows = min(_count_start_rows(problem, segment), max(_MIN_START_FRAMES, len(segment.t) // 3))
        first = 0
        while first + start_rows + MIN_ROWS // 2 <= len(segment.t):
            end = int(np.searchsorted(segment.t, segment.t[first + start_rows - 1] + HORIZON_S, side="right"))
            if first and end == len(segment.t) and end - first - start_rows < start_rows:
                break
            whole = segment
            if isinstance(problem.scene, ContactRichScene):
                whole = add_rest_observations(segment, np.array([first, len(segment.t)]))
            windows.append(PredictionWindow(whole.select_rows(first, end), start_rows))
            first += max((end - first) // 2, start_rows)
    return tuple(one for one in windows if _is_usable(problem, one))


def _is_usable(problem: DiagnosisProblem, one: PredictionWindow) -> bool:
    """Return whether a body moves, every one is observed at the start, and start states have the layout of the whole.

    The layouts differ where a body rests in the first rows and moves in later ones.
    """
    start = one.segment.select_rows(0, one.start_rows)
    if not start.is_observed.any(axis=0).all() or _find_displacements(one.segment).sum() < MIN_ROWS:
        return False
    first, whole = (
        problem.scene.build_model((segment,), problem.simulator_forms).windows[0].start
        for segment in (start, one.segment)
    )
    return bool(first.shape == whole.shape)


def _count_start_rows(problem: DiagnosisProblem, segment: Recording) -> int:
    """Count the frames that determine a start state; more in a contact-rich scene, as hidden spin acts slowly."""
    if not isinstance(problem.scene, ContactRichScene):
        return START_FRAMES
    return max(START_FRAMES, int(np.searchsorted(segment.t, segment.t[0] + problem.scene.initial_window_length)))


def _find_displacements(segment: Recording) -> BoolArray:
    """Return a mask (T, N) of bodies that are away from their median position by more than the noise."""
    middle = np.nanmedian(segment.positions, axis=0)
    return np.asarray((np.abs(segment.positions - middle) > 5 * segment.sigma[:, :, None]).any(axis=2))


def select_predictable(
    problem: DiagnosisProblem, windows: tuple[PredictionWindow, ...], like: EffectFit, rng: np.random.Generator
) -> tuple[PredictionWindow, ...]:
    """Select the windows that the better model can predict from their first rows, and fit their start states.

    In a contact-rich scene, a contact turns micrometres of start error into metres; of a joint without a sensor, a few
    rows of the others hardly show the start. Starts are sampled from their covariance; a body is predicted as long as
    the samples agree about it, and only if it moves.

    Args:
        problem: Scene and priors.
        windows: Prediction windows.
        like: Fit of the better model.
        rng: Random generator of the sampled starts.

    Returns:
        Windows with their start states, NaN where a body cannot be predicted.
    """
    if not windows:
        return ()
    states = _fit_window_starts(problem, windows, like)
    windows = tuple(replace(one, start=start) for one, start in zip(windows, states.starts, strict=True))
    scene = problem.scene
    has_hidden_joints = isinstance(scene, PartlyObservedScene) and scene.hidden
    if not (isinstance(scene, ContactRichScene) or has_hidden_joints):
        return windows
    predictable, error = [], float(np.sqrt(like.lack_of_fit))
    for one in windows:
        # separately: the misfit of one window must not widen the covariance of others
        own = _fit_window_starts(problem, (one,), like)
        spread = _estimate_prediction_spread(problem, one.segment, like, own, rng)
        limit = _MAX_START_SPREAD * error * np.median(one.segment.sigma[one.segment.is_observed])
        lost = np.logical_or.accumulate(~(spread <= limit), axis=0)
        lost |= _find_displacements(one.segment).sum(axis=0) < MIN_ROWS
        lost[: one.start_rows] = False
        segment = replace(one.segment, positions=np.where(lost[..., None], np.nan, one.segment.positions))
        if segment.is_observed[one.start_rows :].any():
            predictable.append(replace(one, segment=segment, start=own.starts[0]))
    return tuple(predictable)


def _fit_window_starts(problem: DiagnosisProblem, windows: tuple[PredictionWindow, ...], like: EffectFit) -> EffectFit:
    """Fit the start states of windows to their first rows."""
    starts = tuple(one.start for one in windows if one.start is not None)
    return fit_start_states(
        problem, tuple(one.segment.select_rows(0, one.start_rows) for one in windows), like, starts or None
    )


def _estimate_prediction_spread(
    problem: DiagnosisProblem, segment: Recording, like: EffectFit, start_fit: EffectFit, rng: np.random.Generator
) -> FloatArray:
    """Estimate the rms spread (T, N) of predictions whose start is sampled from its covariance."""
    start, covariance = start_fit.starts[0], start_fit.shooting.start_covariances[0]
    middle = problem.scene.predict_positions(segment, start, like.shared, like.forms)
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    drawn = start + (rng.standard_normal((_START_SAMPLES, len(start))) * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    off = [problem.scene.predict_positions(segment, one, like.shared, like.forms) - middle for one in drawn]
    return np.asarray(np.sqrt(np.square(off).sum(axis=-1).mean(axis=0)))


def predict_windows(
    problem: DiagnosisProblem, windows: tuple[PredictionWindow, ...], like: EffectFit
) -> tuple[Prediction, ...]:
    """Predict windows with the model and the parameters of a fit, from start states fitted to the first rows.

    Args:
        problem: Scene and priors.
        windows: Prediction windows.
        like: Fit of the model.

    Returns:
        One prediction per window.
    """
    if not windows:
        return ()
    states, predictions = _fit_window_starts(problem, windows, like), []
    for one, start, covariance in zip(windows, states.starts, states.noise_start_covariances, strict=True):
        path = problem.scene.predict_positions(one.segment, start, like.shared, like.forms)
        predictions.append(Prediction(start, covariance, path, sum_squared_errors(one, path - one.segment.positions)))
    return tuple(predictions)


def sum_squared_errors(one: PredictionWindow, miss: FloatArray) -> float:
    """Sum squared errors (T, N, D) over the predicted observations of a window."""
    return float(np.square(miss[one.is_predicted]).sum())
