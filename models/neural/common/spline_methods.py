"""Curves through samples as methods among the networks: linear, cubic, quintic and Akima."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator, make_interp_spline

from models.core.typing import FloatArray
from models.neural.common.method_interface import Budget, Fitted, checked

Curve = Callable[[FloatArray], FloatArray]


def spline(times: FloatArray, states: FloatArray, degree: int) -> Curve:
    """Not-a-knot spline of an odd degree through states (T, ...), of a lower one where samples are few.

    Before and after the samples it goes on as its first and last piece.
    """
    return make_interp_spline(times, states, k=min(degree, len(times) - 1))  # type: ignore[no-any-return]


def akima(times: FloatArray, states: FloatArray) -> Curve:
    """Akima 1970 (doi 10.1145/321607.321609): cubic pieces that one outlier disturbs little."""
    return Akima1DInterpolator(times, states, extrapolate=True)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Spline:
    """A spline as a method: nothing is trained, seed and budget change nothing."""

    name: str
    degree: int

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """The curve through every sample."""
        return _fitted(lambda t, x: spline(t, x, self.degree), times, states)


@dataclass(frozen=True, slots=True)
class Akima:
    """`akima` as a method."""

    name: str = "akima"

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """The curve through every sample."""
        return _fitted(akima, times, states)


def _fitted(through: Callable[[FloatArray, FloatArray], Curve], times: FloatArray, states: FloatArray) -> Fitted:
    began = time.process_time()
    curve = through(*checked(times, states))
    return Fitted(curve, np.empty(0), 0, time.process_time() - began)


LINEAR, CUBIC, QUINTIC, AKIMA = Spline("linear", 1), Spline("cubic", 3), Spline("quintic", 5), Akima()
CURVES = (LINEAR, CUBIC, QUINTIC, AKIMA)
"""Linear is what Chen 2022, eq. 22, calls bilateral."""
