"""Particles of which only coordinates are known: springs are recognised, chance is left to curves."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.estimation.particles.body_names import named_bodies
from models.estimation.particles.particle_fit import Particles, between, curve_through, explain
from models.estimation.particles.particle_prediction import foretell, going_on, growth_of, misses

GRAVITY = np.array([0.0, 981.0])


def thrown(count: int = 31, noise: float = 0.0) -> Particles:
    """One particle in free flight."""
    t = np.arange(count) / 30
    x = np.array([10.0, 300.0]) + t[:, None] * [120.0, -400.0] + 0.5 * GRAVITY * t[:, None] ** 2
    return Particles(t, (x + noise * np.random.default_rng(3).standard_normal(x.shape))[:, None])


def wandering() -> Particles:
    """Two particles that nothing simple moves."""
    t = np.arange(41) / 20
    chance = np.random.default_rng(5)
    return Particles(t, np.cumsum(chance.standard_normal((41, 2, 2)), axis=0))


def test_between_samples_free_flight_is_found_again() -> None:
    particles = thrown(noise=0.2)
    found = explain(particles)
    t = particles.t[:-1] + 1 / 60
    truth = np.array([10.0, 300.0]) + t[:, None] * [120.0, -400.0] + 0.5 * GRAVITY * t[:, None] ** 2
    assert np.sqrt(np.mean((found.motion(t)[:, 0] - truth) ** 2)) < 0.2
    assert found.kind == "free flight"
    assert found.numbers["gravity y"] == pytest.approx(981, rel=0.02)


def test_what_nothing_simple_moves_is_left_to_a_curve_with_an_honest_error() -> None:
    particles = wandering()
    found = explain(particles)
    assert found.kind in ("linear", "cubic", "akima")
    assert found.numbers == {}
    assert np.all((found.sigma > 0.3) & (found.sigma < 3.0))


def test_a_curve_passes_through_what_was_seen_and_missing_samples_are_none() -> None:
    particles = thrown()
    gaps = particles.x.copy()
    gaps[5:8] = np.nan
    motion, _ = curve_through(3)(Particles(particles.t, gaps))
    assert motion(particles.t) == pytest.approx(particles.x, abs=1e-6)


def test_errors_between_samples_are_those_at_samples_that_were_hidden() -> None:
    t = np.arange(21.0)
    x = np.where(np.arange(21) % 2 == 1, 1.0, 0.0)[:, None, None] * np.ones((1, 1, 2))
    assert between(Particles(t, x), curve_through(1)) == pytest.approx([1.0])


def test_free_flight_is_foretold_as_falling_and_truth_lies_within_what_is_promised() -> None:
    seen = thrown(61, noise=0.2)
    past = Particles(seen.t[:41], seen.x[:41])
    found = foretell(past, seen.t[41:])
    off = np.sqrt(np.mean((found.x - seen.x[41:]) ** 2, axis=(1, 2)))
    assert found.kind == "free flight"
    assert np.all(off < 4 * np.hypot(found.sigma, 0.2))
    assert np.all(np.diff(found.sigma) >= 0)


def test_a_straight_course_goes_straight_on() -> None:
    t = np.arange(20) / 10
    x = (t[:, None] * [30.0, -10.0])[:, None]
    motion, _ = going_on(1)(Particles(t, x))
    assert motion(np.array([5.0]))[0, 0] == pytest.approx([150, -50])


def test_errors_grow_with_the_power_that_was_seen() -> None:
    leads = np.linspace(0.1, 1, 10)
    growth = growth_of(leads, 3 * leads**2, wandering())
    assert growth.power == pytest.approx(2.0)
    assert growth.at(np.array([2.0]))[0] == pytest.approx(12.0, rel=0.01)


def test_a_prediction_is_checked_on_samples_that_it_was_not_shown() -> None:
    particles = thrown()
    leads, errors = misses(particles, going_on(2))
    assert len(leads) == len(errors) > 5
    assert errors.max() < 1e-6


def test_names_make_bodies_only_of_points_that_keep_their_distances() -> None:
    t = np.linspace(0, 1, 5)[:, None, None]
    corners = np.array([[0.0, 0], [1, 0], [1, 1]])
    rigid: FloatArray = corners + [5.0, 0.0] * t
    loose: FloatArray = corners * (1 + t) + [0.0, 9.0]
    x = np.concatenate([rigid, loose], axis=1)
    names = ("box-a", "box-b", "box-c", "red-1", "red-2", "red-3")
    found = named_bodies(names, x)
    assert found is not None
    assert found.tolist() == [0, 0, 0, 1, 2, 3]
    assert named_bodies(("a", "b", "c", "d", "e", "f"), x) is None


@pytest.mark.parametrize("rows", [3, 0])
def test_too_few_samples_are_refused(rows: int) -> None:
    with pytest.raises(ValueError, match="at least 4"):
        Particles(np.arange(rows, dtype=float), np.zeros((rows, 2, 2)))
