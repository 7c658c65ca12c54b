"""Errors of a rally: what the residuals of its places tell of them, and what they do not."""

import numpy as np
import pytest

from models.estimation.rally.rally_building import estimate_error_scale, scale_covariance


def test_many_small_residuals_shrink_errors_and_a_few_do_not() -> None:
    rng = np.random.default_rng(3)
    many = [0.5 * rng.normal(size=(300, 2))]
    assert estimate_error_scale(many, 6) == pytest.approx(0.25, rel=0.3)
    few = [np.full((4, 2), 0.25)]  # two degrees of freedom, chi2 of each 0.25
    assert estimate_error_scale(few, 6) >= 1
    assert estimate_error_scale([2 * one for one in many], 6) == pytest.approx(1.0, rel=0.3)
    assert estimate_error_scale([np.full((4, 2), 3.0)], 6) > 9
    assert estimate_error_scale([np.zeros((3, 2))], 6) == 1  # no degree of freedom


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_what_only_a_prior_tells_keeps_its_spread(scale: float) -> None:
    prior, observed = np.diag([1e-6, 4.0]), np.diag([100.0, 0.0])
    covariance = scale_covariance(prior + observed, observed, scale)
    assert covariance[0, 0] == pytest.approx(scale / 100, rel=1e-3)
    assert covariance[1, 1] == pytest.approx(0.25)
