"""Curves through the visible samples, without physics: what every network has to beat."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator, CubicSpline, make_interp_spline

from models.neural.method import Budget, Fitted, checked

Floats = NDArray[np.float64]

NO_LOSS = np.empty(0)


@dataclass(frozen=True, slots=True)
class Curve:
    """A method that learns nothing: `through` makes a function of time from times (T,) and coordinates (T, N, D)."""

    name: str
    through: Callable[[Floats, Floats], Callable[[Floats], Any]]

    def fit(self, times: Floats, states: Floats, seed: int, budget: Budget) -> Fitted:
        """Neither seed nor budget matter."""
        began = time.process_time()
        curve = self.through(*checked(times, states))
        return Fitted(lambda t: np.asarray(curve(t), np.float64), NO_LOSS, 0, time.process_time() - began)


CURVES = (
    Curve("linear", lambda t, x: make_interp_spline(t, x, k=1)),
    Curve("cubic", lambda t, x: CubicSpline(t, x, bc_type="not-a-knot")),
    Curve("quintic", lambda t, x: make_interp_spline(t, x, k=min(5, (len(t) - 1) | 1))),
    Curve("akima", lambda t, x: Akima1DInterpolator(t, x, extrapolate=True)),
)
"""linear is eq. 22 of Chen 2022 (bilateral interpolation); Akima 1970, J. ACM 17, doi 10.1145/321607.321609."""
