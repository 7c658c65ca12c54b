"""How far a start was off is compared with what its first pictures left open, and with nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from diagnosis.fitting.gap_closure import surprise_of

TOLD = np.diag([1.0, 4.0, 1e-6])
BETTER = np.diag([0.1, 0.8, 0.99e-6])
"""The third number is hardly known better than it was told."""


def test_the_error_of_a_start_is_as_surprising_as_chance() -> None:
    rng = np.random.default_rng(0)
    steps = rng.standard_normal((2000, 3)) * np.sqrt(np.diag(TOLD - BETTER))
    found = [surprise_of(step, TOLD, BETTER) for step in steps]
    assert {free for _, free in found} == {2}
    assert kstest([chi for chi, _ in found], "chi2", args=(2,)).pvalue > 1e-3


def test_what_a_window_tells_no_better_does_not_count() -> None:
    """A step of ten standard deviations of the difference of two covariances that are nearly alike."""
    assert surprise_of(np.array([0.0, 0.0, 1e-3]), TOLD, BETTER) == (pytest.approx(0.0), 2)
    assert surprise_of(np.ones(3), TOLD, TOLD * 1.1) == (0.0, 0)


def test_a_step_counts_alike_in_any_unit() -> None:
    unit = np.array([1e3, 1e-3, 1.0])
    chi, free = surprise_of(np.ones(3), TOLD, BETTER)
    other, same = surprise_of(unit, TOLD * unit * unit[:, None], BETTER * unit * unit[:, None])
    assert (other, same) == (pytest.approx(chi), free)
