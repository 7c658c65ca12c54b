"""Splines through samples: exact on polynomials, and strict about their input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from models.core.typing import FloatArray
from models.neural.common.method_interface import AKIMA, CUBIC, CURVES, LINEAR, QUINTIC, MotionMethod, TrainingBudget


def polynomial(t: FloatArray, degree: int) -> FloatArray:
    """(T, 1, 2)"""
    weights = np.random.default_rng(degree).standard_normal((degree + 1, 1, 2))
    return np.einsum("tk,knd->tnd", t[:, None] ** np.arange(degree + 1), weights)


@pytest.mark.parametrize(("method", "degree"), [(LINEAR, 1), (AKIMA, 1), (CUBIC, 3), (QUINTIC, 5)])
def test_a_curve_is_exact_on_polynomials_of_its_degree(method: MotionMethod, degree: int) -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 12))
    at = np.linspace(t[0], t[-1] + 0.1, 50)
    assert np.allclose(
        method.fit(t, polynomial(t, degree), 0, TrainingBudget()).at(at), polynomial(at, degree), atol=1e-8
    )


def test_the_cubic_is_the_not_a_knot_spline() -> None:
    t = np.linspace(0, 1, 9)
    x = np.random.default_rng(1).standard_normal((9, 3, 2))
    at = np.linspace(0, 1, 33)
    assert np.allclose(CUBIC.fit(t, x, 0, TrainingBudget()).at(at), CubicSpline(t, x)(at), atol=1e-9)


@pytest.mark.parametrize("method", CURVES, ids=lambda method: method.name)
def test_every_curve_passes_through_its_samples(method: MotionMethod) -> None:
    t = np.linspace(0, 1, 4)
    x = np.random.default_rng(2).standard_normal((4, 2, 2))
    fitted = method.fit(t, x, 0, TrainingBudget())
    assert np.allclose(fitted.at(t), x)


@pytest.mark.parametrize(
    ("times", "states"),
    [(np.arange(3.0), np.zeros((3, 1, 2))), (np.zeros(5), np.zeros((5, 1, 2))), (np.arange(5.0), np.zeros((5, 2)))],
)
def test_samples_that_are_no_motion_are_refused(times: FloatArray, states: FloatArray) -> None:
    with pytest.raises(ValueError, match=r"motion|rise"):
        CUBIC.fit(times, states)
