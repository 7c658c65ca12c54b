"""Probability regions: of normal distributions exactly, of draws by rank."""

from __future__ import annotations

import numpy as np
import pytest

from models.estimation.forecast.ensemble_prediction import (
    level_by_neighbours,
    level_of_normal,
)


def test_the_level_of_a_normal_distribution_is_the_chi2_of_two_degrees_of_freedom() -> None:
    covariance = np.array([[4e-4, 1e-4], [1e-4, 2e-4]])
    root = np.linalg.cholesky(covariance)
    for level in (0.1, 0.5, 0.9):
        there = root @ np.array([np.sqrt(-2 * np.log(1 - level)), 0.0])
        assert level_of_normal(there, covariance) == pytest.approx(level, abs=1e-6)


def test_a_ball_at_its_certain_predicted_place_has_level_0() -> None:
    assert level_of_normal(np.zeros(2), np.zeros((2, 2))) == 0.0


def test_places_that_come_from_the_draws_own_distribution_have_even_levels() -> None:
    rng = np.random.default_rng(0)
    levels = np.array([level_by_neighbours(*_one_and_others(rng)) for _ in range(400)])
    for share in (0.25, 0.5, 0.9):
        assert np.mean(levels <= share) == pytest.approx(share, abs=3 * np.sqrt(share * (1 - share) / 400))


def _one_and_others(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two branches, as after a ball that may or may not have been touched."""
    draws = rng.normal(0, [0.01, 0.03], (257, 2)) + np.where(rng.random((257, 1)) < 0.7, [0.0, 0.0], [0.5, 0.2])
    return draws[0], draws[1:]


def test_between_two_branches_is_outside_of_both() -> None:
    draws = np.random.default_rng(1).normal(0, 0.01, (256, 2))
    draws[128:] += [1.0, 0.0]
    assert level_by_neighbours(np.array([0.5, 0.0]), draws) == 1.0
    assert level_by_neighbours(np.array([1.0, 0.0]), draws) < 0.5


def test_measurement_noise_widens_the_region() -> None:
    draws = np.random.default_rng(2).normal(0, 1e-4, (256, 2))
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    around = 1e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert all(level_by_neighbours(there, draws) == 1.0 for there in around)
    levels = [level_by_neighbours(there, draws, noise=1e-6 * np.eye(2)) for there in around]
    assert np.mean(levels) == pytest.approx(1 - np.exp(-0.5), abs=0.05)
