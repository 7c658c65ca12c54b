"""Robust statistics: a loss that single outliers cannot dominate, and scales that ignore them."""

from __future__ import annotations

import numpy as np
import pytest

from models.numerics.statistics import (
    HUBER_THRESHOLD,
    estimate_norm_sigma,
    estimate_sigma,
    evaluate_huber_loss,
    evaluate_pair_loss,
    huber_losses,
)


def test_small_residuals_count_by_their_square_and_large_ones_by_their_norm() -> None:
    residual = np.array([[0.0, 0.0], [0.3, -0.4], [30.0, 40.0]])
    weight, cost = evaluate_huber_loss(residual)
    np.testing.assert_allclose(weight, [1.0, 1.0, HUBER_THRESHOLD / 50])
    losses = [0.0, 0.25, 2 * 50 * HUBER_THRESHOLD - HUBER_THRESHOLD**2]
    np.testing.assert_allclose(huber_losses(residual), losses)
    assert cost == pytest.approx(sum(losses))


def test_the_loss_does_not_depend_on_the_axes_and_its_slope_is_that_of_the_weights() -> None:
    residual, angle = np.random.default_rng(0).normal(0, 3, (40, 2)), 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    weight, cost = evaluate_huber_loss(residual)
    assert evaluate_huber_loss(residual @ turn)[1] == pytest.approx(cost)
    step = 1e-6 * np.array([1.0, 0.0])
    slope = (huber_losses(residual + step) - huber_losses(residual - step)) / 2e-6
    np.testing.assert_allclose(slope, 2 * weight * residual[:, 0], atol=1e-6)


def test_pairs_are_bounded_and_further_rows_are_not() -> None:
    weight, cost = evaluate_pair_loss(np.array([0.0, 10.0, 1.0, 0.0, 10.0]), 4)
    np.testing.assert_allclose(weight, [0.25, 0.25, 1.0, 1.0, 1.0])
    assert cost == pytest.approx((2 * 10 * 2.5 - 2.5**2) + 1 + 100)


def test_residuals_that_are_not_finite_cost_infinitely_much() -> None:
    residual = np.array([[1.0, 0.0], [np.nan, 0.0]])
    weight, cost = evaluate_huber_loss(residual)
    assert cost == np.inf
    np.testing.assert_array_equal(weight, 0.0)
    assert np.isinf(huber_losses(residual)).all()


def test_a_third_of_outliers_hardly_changes_a_standard_deviation() -> None:
    rng = np.random.default_rng(1)
    values = 7.0 + 0.5 * rng.standard_normal((6000, 2))
    assert estimate_sigma(values[:, 0]) == pytest.approx(0.5, rel=0.03)
    assert estimate_sigma(values[:, 0] - 7, 0.0) == pytest.approx(0.5, rel=0.03)
    assert estimate_norm_sigma(np.hypot(*(values - 7).T)) == pytest.approx(0.5, rel=0.03)
    values[:2000] += 100
    assert estimate_sigma(values[:, 0]) < 1.1
