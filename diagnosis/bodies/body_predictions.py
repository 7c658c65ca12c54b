"""Open-loop predictions of hold-out shots in which every body has strengths of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.bodies.body_strengths import BodyFit, split_bodies
from diagnosis.fitting.gap_closure import GapClosure, estimate_closure, estimate_noise_floor
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit
from diagnosis.fitting.prediction_windows import (
    Predictions,
    PredictionWindow,
    build_prediction_windows,
    predict_windows,
    select_predictable,
)
from models.core.recording import Recording
from models.core.typing import FloatArray


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
