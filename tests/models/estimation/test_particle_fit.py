"""Particles with unknown physics: springs are recognised, irregular motion is left to curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.recording import Recording, record_points
from models.core.typing import FloatArray
from models.estimation.particle_fit import (
    MIN_SAMPLES,
    build_extrapolation,
    build_spline_fit,
    estimate_holdout_errors,
    fit_error_growth,
    fit_particles,
    forecast_particles,
    group_by_name,
    list_candidate_fits,
    measure_backtest_errors,
)

GRAVITY = np.array([0.0, 981.0])


def free_flight(count: int = 31, noise: float = 0.0) -> Recording:
    """One particle in free flight."""
    t = np.arange(count) / 30
    x = np.array([10.0, 300.0]) + t[:, None] * [120.0, -400.0] + 0.5 * GRAVITY * t[:, None] ** 2
    return record_points(t, (x + noise * np.random.default_rng(3).standard_normal(x.shape))[:, None])


def irregular_motion() -> Recording:
    """Two particles without a simple law of motion."""
    t = np.arange(41) / 20
    chance = np.random.default_rng(5)
    return record_points(t, np.cumsum(chance.standard_normal((41, 2, 2)), axis=0))


def test_free_flight_is_recovered_between_samples() -> None:
    particles = free_flight(noise=0.2)
    result = fit_particles(particles)
    t = particles.t[:-1] + 1 / 60
    truth = np.array([10.0, 300.0]) + t[:, None] * [120.0, -400.0] + 0.5 * GRAVITY * t[:, None] ** 2
    assert np.sqrt(np.mean((result.motion(t)[:, 0] - truth) ** 2)) < 0.2
    assert result.kind == "free flight"
    assert result.parameters["gravity y"] == pytest.approx(981, rel=0.02)


def test_irregular_motion_is_fitted_by_a_curve_with_a_true_error() -> None:
    particles = irregular_motion()
    result = fit_particles(particles)
    assert result.kind in ("linear", "cubic", "akima")
    assert result.parameters == {}
    assert np.all((result.sigma > 0.3) & (result.sigma < 3.0))


def test_a_curve_passes_through_the_observed_samples() -> None:
    particles = free_flight()
    gaps = particles.positions.copy()
    gaps[5:8] = np.nan
    motion, _ = build_spline_fit(3)(replace(particles, positions=gaps))
    assert motion(particles.t) == pytest.approx(particles.positions, abs=1e-6)


def test_errors_between_samples_are_those_at_withheld_samples() -> None:
    t = np.arange(21.0)
    x = np.where(np.arange(21) % 2 == 1, 1.0, 0.0)[:, None, None] * np.ones((1, 1, 2))
    assert estimate_holdout_errors(record_points(t, x), build_spline_fit(1)) == pytest.approx([1.0])


def test_free_flight_is_predicted_as_falling_within_its_errors() -> None:
    observed = free_flight(61, noise=0.2)
    past = observed.select_rows(0, 41)
    result = forecast_particles(past, observed.t[41:])
    off = np.sqrt(np.mean((result.x - observed.positions[41:]) ** 2, axis=(1, 2)))
    assert result.kind == "free flight"
    assert np.all(off < 4 * np.hypot(result.sigma, 0.2))
    assert np.all(np.diff(result.sigma) >= 0)


def test_a_straight_motion_is_extrapolated_straight() -> None:
    t = np.arange(20) / 10
    x = (t[:, None] * [30.0, -10.0])[:, None]
    motion, _ = build_extrapolation(1)(record_points(t, x))
    assert motion(np.array([5.0]))[0, 0] == pytest.approx([150, -50])


def test_errors_grow_with_the_observed_power() -> None:
    leads = np.linspace(0.1, 1, 10)
    growth = fit_error_growth(leads, 3 * leads**2, irregular_motion())
    assert growth.power == pytest.approx(2.0)
    assert growth.sigma_at(np.array([2.0]))[0] == pytest.approx(12.0, rel=0.01)


def test_a_prediction_is_compared_with_withheld_samples() -> None:
    particles = free_flight()
    leads, errors = measure_backtest_errors(particles, build_extrapolation(2))
    assert len(leads) == len(errors) > 5
    assert errors.max() < 1e-6


def test_names_group_only_points_with_constant_distances() -> None:
    t = np.linspace(0, 1, 5)[:, None, None]
    corners = np.array([[0.0, 0], [1, 0], [1, 1]])
    rigid: FloatArray = corners + [5.0, 0.0] * t
    loose: FloatArray = corners * (1 + t) + [0.0, 9.0]
    x = np.concatenate([rigid, loose], axis=1)
    names = ("box-a", "box-b", "box-c", "red-1", "red-2", "red-3")
    result = group_by_name(names, x)
    assert result is not None
    assert result.tolist() == [0, 0, 0, 1, 2, 3]
    assert group_by_name(("a", "b", "c", "d", "e", "f"), x) is None


@pytest.mark.parametrize("rows", [3, 0])
def test_too_few_samples_are_refused(rows: int) -> None:
    with pytest.raises(ValueError, match="at least 4"):
        record_points(np.arange(rows, dtype=float), np.zeros((rows, 2, 2))).require_samples(MIN_SAMPLES)


@pytest.mark.parametrize(
    ("corners", "bodies", "are_bodies"),
    [(2, 2, False), (3, 2, True), (3, 170, True), (3, 230, False)],  # sticks are springs; many bodies take too long
)
def test_three_points_make_a_rigid_body(corners: int, bodies: int, are_bodies: bool) -> None:
    t = np.linspace(0, 1, 15)
    shape = np.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.8]])[:corners]
    turned = np.stack([np.cos(2 * t), np.sin(2 * t), -np.sin(2 * t), np.cos(2 * t)], axis=1).reshape(-1, 2, 2)
    x: FloatArray = np.concatenate([shape @ turned + [3 * k, 0.0] for k in range(bodies)], axis=1)
    names = tuple(f"body{k // corners}-{k % corners}" for k in range(bodies * corners))
    fits = list_candidate_fits(record_points(t, x, names))
    assert ("rigid bodies" in fits) == are_bodies


@pytest.mark.parametrize(("count", "power"), [(3, 1.5), (2, 0.0)])
def test_the_growth_of_errors_takes_three_of_them(count: int, power: float) -> None:
    """Through two errors every power law passes."""
    leads, moving = np.array([0.1, 0.4, 0.9])[:count], irregular_motion()
    growth = fit_error_growth(leads, 0.2 * leads**1.5, moving)
    extent = float(np.std(moving.positions))
    assert growth.sigma_at(np.array([2.0]))[0] == pytest.approx(0.2 * 2**1.5 if power else extent, rel=0.3)
