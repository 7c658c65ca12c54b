"""What an observation costs a flight, and how it pulls it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.estimation.rally.flight_fit import RallyFit, RallyStructure, refine_fit
from models.estimation.rally.flight_observations import (
    CLUTTER_COST,
    EVEN_SQUARES,
    bound_residuals,
    prepare_observations,
)
from models.estimation.rally.single_flight import build_flight_prior
from models.numerics.statistics import correlation_factor, measure_lack_of_fit
from models.physics.flight.flight_motion import fly
from models.sports.badminton import SPORT
from tests.support.simple_rallies import usual_view


def test_a_place_far_from_a_flight_costs_as_much_as_clutter_and_does_not_pull() -> None:
    residual = np.array([[500.0, 300.0]])
    factor, slope = bound_residuals(residual, most=CLUTTER_COST)
    assert ((residual * factor[:, None]) ** 2).sum() == pytest.approx(2 * CLUTTER_COST, abs=1e-4)
    assert abs(slope[0]) < 1e-9


def test_the_slope_of_a_bounded_residual_is_the_gradient_of_its_cost() -> None:
    sizes, step = np.array([0.01, 0.7, 3.0, 8.0, 11.0, 14.0]), 1e-5

    def cost(x: np.ndarray) -> np.ndarray:
        factor, _ = bound_residuals(np.column_stack([x, 0 * x]), most=CLUTTER_COST)
        return np.asarray((x * factor) ** 2)

    factor, slope = bound_residuals(np.column_stack([sizes, 0 * sizes]), most=CLUTTER_COST)
    by_differences = (cost(sizes + step) - cost(sizes - step)) / (2 * step)
    assert 2 * sizes * factor * slope == pytest.approx(by_differences, rel=1e-4)


def test_clutter_is_as_probable_as_a_flight_at_even_squares() -> None:
    """Eleven standard deviations with the tails of a detector; the share that pulls is the probability of a flight."""
    sizes = np.array([6.0, 10.9, 11.1])
    residual = np.column_stack([sizes, 0 * sizes])
    (alone, whole), (factor, slope) = bound_residuals(residual), bound_residuals(residual, most=CLUTTER_COST)
    chance = slope * factor / (whole * alone)
    assert chance == pytest.approx([0.997, 0.51, 0.47], abs=0.03)
    assert (((residual * factor[:, None]) ** 2).sum(axis=1) < EVEN_SQUARES).tolist() == [True, True, False]


def test_residuals_on_both_sides_of_one_that_is_left_out_are_no_neighbours() -> None:
    """Of a series that alternates in sign, every second one alone is all of one sign."""
    rng = np.random.default_rng(5)
    series = [rng.standard_normal((400, 2)) + 2 * (-1.0) ** np.arange(400)[:, None] for _ in range(3)]
    every = [np.where(np.arange(400)[:, None] % 4 < 2, one, np.nan) for one in series]
    close = [one[np.isfinite(one[:, 0])] for one in every]
    assert correlation_factor(every) == correlation_factor(series) == 1.0
    assert measure_lack_of_fit(every, 0)[0] == pytest.approx(measure_lack_of_fit(close, 0)[0])


def test_a_place_that_a_person_set_is_no_clutter() -> None:
    """It costs and pulls as a place with the tails of a detector, while its neighbour does not."""
    camera, t = usual_view(SPORT).camera, np.array([0.0, 0.04])
    px = np.array([[600.0, 300.0], [610.0, 300.0]])
    observed = prepare_observations(camera, np.arange(2), t, px, 0 * px, 0 * px + 2.0)
    most = replace(observed, placed=t[:1]).select(slice(0, 2)).bound_clutter(CLUTTER_COST)
    residual = np.array([[60.0, 0.0], [60.0, 0.0]])
    factor, slope = bound_residuals(residual, most=most)
    costs = ((residual * factor[:, None]) ** 2).sum(axis=1)
    assert costs == pytest.approx([9 * np.log1p(400.0), 2 * CLUTTER_COST], abs=1e-4)
    assert slope == pytest.approx([1 / (401 * factor[0]), 0.0], abs=1e-5)


def fit_lift(false: np.ndarray) -> RallyFit:
    """Fit a high lift that leaves the image, with `false` places (K, 2), px, in frames that do not show it."""
    camera, p = usual_view(SPORT).camera, build_flight_prior(SPORT).mean.copy()
    p[:6] = 9.0, 3.0, 0.8, -24.0, 1.0, 42.0
    t = np.arange(0.02, 2.3, 0.04)
    px = camera.to_pixels(fly(p, t, SPORT.object.turn_length).states[:, :3])
    px = px + np.random.default_rng(3).normal(0, 0.7, px.shape)
    inside = ((px > 0) & (px < [1280, 720])).all(axis=1)
    hidden = np.flatnonzero(~inside)
    rows = hidden[len(hidden) // 2 :][: len(false)]
    px[rows], inside[rows] = false, True
    seen = np.flatnonzero(inside)
    spread = np.full((len(seen), 2), 0.7)
    observed = prepare_observations(camera, seen, t[seen], px[seen], 0 * spread, spread)
    structure = RallyStructure(("hit",), (False,), t[seen[:1]], t[seen[-1:]], np.zeros(1))
    fit = refine_fit(observed, SPORT, structure, np.concatenate([p[[6, 11, 10, 12]], p, t[seen[:1]]]))
    assert fit is not None
    return fit


def test_what_is_seen_while_a_flight_is_outside_of_the_image_is_clutter() -> None:
    """Three places on a racket cost the price of clutter, and do not draw the flight to them."""
    racket = np.array([[600.0, 420.0], [606.0, 418.0], [613.0, 415.0]])
    alone, beside = fit_lift(np.empty((0, 2))), fit_lift(racket)
    assert alone.evidence - beside.evidence == pytest.approx(len(racket) * CLUTTER_COST, abs=1.0)
    off = np.abs(beside.values - alone.values)
    assert (off < 0.3 * np.sqrt(np.diag(alone.covariance)) + 1e-9).all()
