"""The error of a start state is compared with the covariance of its fit to the first frames alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from diagnosis.fitting.gap_closure import start_error_chi2

COVARIANCE = np.diag([1.0, 4.0, 1e-6])
BETTER = np.diag([0.1, 0.8, 0.99e-6])
"""The whole window hardly reduces the variance of the third component."""


def test_the_error_of_a_start_is_as_surprising_as_chance() -> None:
    rng = np.random.default_rng(0)
    steps = rng.standard_normal((2000, 3)) * np.sqrt(np.diag(COVARIANCE - BETTER))
    chi2_values = [start_error_chi2(step, COVARIANCE, BETTER) for step in steps]
    assert {free for _, free in chi2_values} == {2}
    assert kstest([chi for chi, _ in chi2_values], "chi2", args=(2,)).pvalue > 1e-3


def test_what_a_window_tells_no_better_does_not_count() -> None:
    """A step of ten standard deviations of the difference of two covariances that are nearly alike."""
    assert start_error_chi2(np.array([0.0, 0.0, 1e-3]), COVARIANCE, BETTER) == (pytest.approx(0.0), 2)
    assert start_error_chi2(np.ones(3), COVARIANCE, COVARIANCE * 1.1) == (0.0, 0)


def test_a_step_counts_alike_in_any_unit() -> None:
    unit = np.array([1e3, 1e-3, 1.0])
    chi, free = start_error_chi2(np.ones(3), COVARIANCE, BETTER)
    other, same = start_error_chi2(unit, COVARIANCE * unit * unit[:, None], BETTER * unit * unit[:, None])
    assert (other, same) == (pytest.approx(chi), free)
