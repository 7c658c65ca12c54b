"""Splines through samples with the interface of the networks: linear, cubic, quintic and Akima."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator, make_interp_spline

from models.core.typing import FloatArray
from models.neural.common.method_interface import FittedMotion, TrainingBudget, validate_samples

Curve = Callable[[FloatArray], FloatArray]


def fit_spline(times: FloatArray, states: FloatArray, degree: int) -> Curve:
    """Fit a not-a-knot spline through all samples.

    Args:
        times: Times (T,), s, increasing.
        states: Values (T, ...).
        degree: Odd degree; reduced if there are too few samples.

    Returns:
        Curve that maps times (M,) to values (M, ...). Outside the samples the first and last piece continue.
    """
    return make_interp_spline(times, states, k=min(degree, len(times) - 1))  # type: ignore[no-any-return]


def fit_akima(times: FloatArray, states: FloatArray) -> Curve:
    """Fit an Akima spline, whose cubic pieces are robust to single outliers.

    Akima 1970, doi:10.1145/321607.321609.

    Args:
        times: Times (T,), s, increasing.
        states: Values (T, ...).

    Returns:
        Curve that maps times (M,) to values (M, ...).
    """
    return Akima1DInterpolator(times, states, extrapolate=True)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class SplineMethod:
    """Spline as a method; seed and budget have no effect."""

    name: str
    degree: int

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Fit the curve through all samples; arguments as in `MotionMethod.fit`."""
        return _fit_curve(lambda t, x: fit_spline(t, x, self.degree), times, states)


@dataclass(frozen=True, slots=True)
class AkimaMethod:
    """Akima spline as a method; seed and budget have no effect."""

    name: str = "akima"

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Fit the curve through all samples; arguments as in `MotionMethod.fit`."""
        return _fit_curve(fit_akima, times, states)


def _fit_curve(
    through: Callable[[FloatArray, FloatArray], Curve], times: FloatArray, states: FloatArray
) -> FittedMotion:
    began = time.process_time()
    curve = through(*validate_samples(times, states))
    return FittedMotion(curve, np.empty(0), 0, time.process_time() - began)


LINEAR, CUBIC, QUINTIC, AKIMA = (
    SplineMethod("linear", 1),
    SplineMethod("cubic", 3),
    SplineMethod("quintic", 5),
    AkimaMethod(),
)
# All splines. Linear interpolation is the bilateral method of Chen 2022, eq. 22.
CURVES = (LINEAR, CUBIC, QUINTIC, AKIMA)
