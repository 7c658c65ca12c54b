"""Doubtful events of a rally, tried otherwise."""

from __future__ import annotations

import numpy as np

from models.core.rally import RallyEventKind
from models.core.typing import FloatArray
from models.estimation.rally.event_evidence import NET_SPREAD, leave_net
from models.estimation.rally.flight_fit import (
    RallyFit,
    RallyStructure,
    flight_slice,
    refine_fit,
)
from models.estimation.rally.flight_observations import FlightObservations, prepare_observations
from models.estimation.rally.rally_revision import revise_structures
from models.estimation.rally.single_flight import TURN_DRAG, build_flight_prior
from models.physics.flight.flight_motion import find_descent, fly
from models.sports.badminton import SPORT
from models.sports.table_tennis import SPORT as TABLE_TENNIS
from tests.support.simple_rallies import usual_view

TURN = SPORT.object.turn_length
KINDS: tuple[RallyEventKind, ...] = ("hit", "hit")


def state_flight(*state: float) -> FloatArray:
    p = build_flight_prior(SPORT).mean.copy()
    p[:6] = state
    return p


def film_flights(flights: list[FloatArray], moments: FloatArray) -> FlightObservations:
    """Film flights that follow each other at moments (F + 1,), s, 50 times per s."""
    t = np.arange(moments[0] + 0.01, moments[-1] - 0.01, 0.02)
    rows = np.searchsorted(moments, t) - 1
    xyz = np.array(
        [fly(flights[k], np.array([now - moments[k]]), TURN).states[0, :3] for k, now in zip(rows, t, strict=True)]
    )
    camera = usual_view(SPORT).camera
    px = camera.to_pixels(xyz) + np.random.default_rng(0).normal(0, 0.7, (len(t), 2))
    return prepare_observations(camera, np.arange(len(t)), t, px, np.zeros((len(t), 2)), np.full((len(t), 2), 0.7))


def fit_from(
    observed: FlightObservations,
    flights: list[FloatArray],
    moments: FloatArray,
    kinds: tuple[RallyEventKind, ...] = KINDS,
) -> RallyFit | None:
    structure = RallyStructure(kinds, (False, True), moments[:2], moments[1:], np.zeros(2))
    shared = flights[0][[6, 11, 10, 12]]
    return refine_fit(observed, SPORT, structure, np.concatenate([shared, *flights, moments[:2]]))


def test_a_stroke_that_seems_to_fly_on_is_tried_in_the_other_direction() -> None:
    there = state_flight(2.0, 2.5, 1.5, 24.0, 0.5, 14.0)
    turning = fly(there, np.array([1.2]), TURN).states[0, :3]
    back = state_flight(*turning, -45.0, 1.0, 8.0)
    moments = np.array([0.0, 1.2, 2.2])
    observed = film_flights([there, back], moments)
    wrong = back.copy()
    wrong[3] = 80.0
    fit = fit_from(observed, [there, wrong], moments)
    assert fit is not None
    revision = revise_structures(observed, SPORT, [fit])[0]
    best = revision.best
    assert fit.values[flight_slice(1)][3] > 0
    assert best.values[flight_slice(1)][3] < -20
    assert best.evidence > fit.evidence + 100
    assert not any(doubt.gain > -1 for doubt in revision.doubts), "the same hit in another place leaves no doubt of it"


def test_a_shuttle_that_turns_over_is_not_more_slender_than_one_that_flies() -> None:
    there = state_flight(2.0, 2.5, 1.5, 24.0, 0.5, 14.0)
    there[TURN_DRAG] = -1.0
    turning = fly(there, np.array([1.2]), TURN).states[0, :3]
    flights, moments = [there, state_flight(*turning, -45.0, 1.0, 8.0)], np.array([0.0, 1.2, 2.2])
    flights[1][TURN_DRAG] = -1.0
    fit = fit_from(film_flights(flights, moments), flights, moments)
    assert fit is not None
    assert fit.values[2] > -0.2, "the drag of the turn-over that all flights share"


def take_return_for_net() -> tuple[FlightObservations, RallyFit]:
    """Take a return from 33 cm behind the net for a touch of it.

    The service is seen at its start, and the clear that answers it once it is on its way.
    """
    service = state_flight(4.9, 2.7, 1.2, 5.0, -1.0, 4.0)
    met = fly(service, np.array([0.6]), TURN).states[0, :3]
    moments = np.array([0.0, 0.6, 1.7])
    flights = [service, state_flight(*met, -14.0, 8.0, 11.0)]
    seen = film_flights(flights, moments)
    observed = seen.select(np.flatnonzero((seen.t < 0.1) | (seen.t > 0.7)))
    fit = fit_from(observed, flights, moments, ("hit", "net"))
    assert fit is not None
    return observed, fit


def test_a_return_from_near_the_net_is_not_left_a_touch_of_it() -> None:
    observed, fit = take_return_for_net()
    best = revise_structures(observed, SPORT, [fit])[0].best
    assert best.structure.kinds == ("hit", "hit")


def test_a_net_gives_no_speed() -> None:
    fit = take_return_for_net()[1]
    first, second = (fit.values[flight_slice(k)] for k in (0, 1))
    came = fly(first, fit.values[-1:] - fit.values[-2], TURN).states[0, 3:]
    assert np.linalg.norm(second[3:6]) < np.linalg.norm(came) + 2 * NET_SPREAD


def test_a_net_lets_nothing_through_and_pushes_nothing_aside() -> None:
    velocity, height = np.array([[20.0, 3.0, -4.0]]), SPORT.net.height
    (left, off), (below, stops) = (
        leave_net(velocity, np.array([[6.7, 3.0, z]]), SPORT) for z in (height, height - 0.3)
    )
    assert off[0, 1] < 0.25 * off[0, 0], "nothing pushes along the net"
    assert below[0, 0] * 20 + 2 * stops[0, 0] < 5, "the body of the net stops what flies into it"
    assert left[0, 0] * 20 + 2 * off[0, 0] > 10, "its tape may let it pass"


def test_a_bounce_on_the_floor_behind_a_table_is_not_left_on_the_table() -> None:
    """One ray of the camera meets both surfaces."""
    sport, radius = TABLE_TENNIS, TABLE_TENNIS.object.radius
    prior = build_flight_prior(sport).mean
    camera = usual_view(sport).camera
    there = prior.copy()
    there[:6] = 0.2, 0.8, 0.3, 3.0, 3.0, 1.5
    fall = find_descent(there, 0.0, sport.floor + radius, 0.0, 3.0)
    bounced = prior.copy()
    bounced[:6] = fly(there, np.array([fall]), 0.0).states[0] * [1, 1, 1, 0.9, 0.9, -0.86]
    t = np.array([*np.arange(0.01, fall - 0.05, 0.02), *np.arange(fall + 0.05, fall + 0.5, 0.02)])
    rows = [(there, now) if now < fall else (bounced, now - fall) for now in t]
    xyz = np.array([fly(p, np.array([tau]), 0.0).states[0, :3] for p, tau in rows])
    px = camera.to_pixels(xyz) + np.random.default_rng(0).normal(0, 0.7, (len(t), 2))
    nothing, sigma = np.zeros((len(t), 2)), np.full((len(t), 2), 0.7)
    observed = prepare_observations(camera, np.arange(len(t)), t, px, nothing, sigma)
    moments = np.array([0.0, fall, t[-1]])
    structure = RallyStructure(("hit", "bounce"), (False, True), moments[:2], moments[1:], np.zeros(2))
    fit = refine_fit(observed, sport, structure, np.concatenate([prior[[6, 11, 10, 12]], there, bounced, moments[:2]]))
    assert fit is not None
    best = revise_structures(observed, sport, [fit])[0].best
    assert best.structure.heights[-1] == sport.floor
    assert np.abs(best.values[flight_slice(1)][:3] - bounced[:3]).max() < 0.1
