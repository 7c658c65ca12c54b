"""Flights that one camera filmed show what force a simulator lacks, by their places in the image alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.simple_rallies import usual_view

from diagnosis.diagnose import diagnose
from models.core.rally import Flight, Rally
from models.core.typing import FloatArray
from models.estimation.gap_scenes.filmed_flight_scene import build_filmed_flight_scene
from models.estimation.rally.recorded_flights import TURN_LENGTHS, record_flights
from models.sports.sport_catalogue import find_sports

NOISE_PX, FPS = 0.7, 25.0


def film_shuttles(wind: float, seed: int = 5, count: int = 12) -> Rally:
    """Film shuttles that fly to and fro in a wind along the court, m/s, by an own law; the fit is off by 0.2 m."""
    sport, rng = find_sports()["badminton"], np.random.default_rng(seed)
    scene, k = usual_view(sport), sport.object.drag.mean

    def accelerate(_: float, state: FloatArray) -> FloatArray:
        through_air = state[3:] - [wind, 0, 0]
        return np.array([*state[3:], *(-k * np.linalg.norm(through_air) * through_air - [0, 0, 9.81])])

    begin, times, places, flights = 0.0, [], [], []
    for number in range(count):
        ahead = 1 if number % 2 == 0 else -1
        place = np.array([6.7 - 5.2 * ahead, rng.uniform(1.5, 4.6), rng.uniform(1, 2.4)])
        speed, rise = rng.uniform(14, 30), rng.uniform(0.4, 0.9)
        velocity = speed * np.array([ahead * np.cos(rise), 0.15 * rng.standard_normal(), np.sin(rise)])
        t = np.arange(0, rng.uniform(0.9, 1.3), 1 / FPS)
        path = solve_ivp(accelerate, (0, 2), [*place, *velocity], t_eval=t, rtol=1e-9, atol=1e-9).y.T
        px = scene.camera.to_pixels(path[:, :3])
        fitted = np.array([*(place + rng.normal(0, 0.2, 3)), *(velocity + rng.normal(0, 0.5, 3)), k, 0, 0, 0, 0])
        flights.append(Flight(begin, begin + t[-1], fitted, 1e-4 * np.eye(11), False, 1.0))
        times.append(begin + t)
        places.append(px + NOISE_PX * rng.standard_normal(px.shape))
        begin = np.ceil(FPS * (begin + t[-1] + 0.2)) / FPS
    t, px = np.concatenate(times), np.vstack(places)
    frame, sigma = np.rint(FPS * t).astype(np.int64), np.full(px.shape, NOISE_PX)
    return Rally(scene, frame, t, px, sigma, 0 * px, np.ones(len(t), np.bool_), tuple(flights), ())


@pytest.mark.parametrize(("wind", "effects"), [(0.0, ()), (2.0, ("wind",))])
def test_a_wind_that_the_simulator_lacks_is_named_and_nothing_where_it_lacks_nothing(
    wind: float, effects: tuple[str, ...]
) -> None:
    report = diagnose(build_filmed_flight_scene(("air_drag",)), record_flights(film_shuttles(wind)))
    assert report.effects == effects
    assert report.verdict == ("effects" if effects else "none")
    assert report.gap.metric == "rms_px"
    if effects:
        strengths = {one.name: one for one in report.candidates[0].strengths}
        assert strengths["wind_x"].value == pytest.approx(wind, abs=4 * strengths["wind_x"].sigma)


def test_derivatives_are_those_of_differences() -> None:
    recordings = record_flights(film_shuttles(1.0, count=2))
    model = build_filmed_flight_scene(("air_drag",)).build_model(recordings, ())
    start, shared = model.windows[0].start, np.zeros(len(model.unknowns))
    shared[0] = 0.2
    linear = model.linearize(0, start, shared)
    for values, by in ((start, linear.start_jacobian), (shared, linear.shared_jacobian)):
        for k in range(3):
            step = np.zeros(len(values))
            step[k] = 1e-5
            pairs = [(start + s * step, shared) if values is start else (start, shared + s * step) for s in (1, -1)]
            ahead, back = (model.simulate(0, *pair).residual for pair in pairs)
            assert by[..., k] == pytest.approx((ahead - back) / 2e-5, rel=1e-4, abs=1e-3)


def test_a_flight_begins_after_its_turn_over() -> None:
    rally = film_shuttles(0.0, count=2)
    turning = replace(rally, flights=tuple(replace(one, begins_with_hit=True) for one in rally.flights))
    whole, late = record_flights(rally), record_flights(turning)
    way = late[0].inputs[0, 0, 3:6, 0] - rally.flights[0].parameters[:3]
    assert len(late[0].t) < len(whole[0].t)
    assert np.linalg.norm(way) > 0.9 * TURN_LENGTHS * rally.scene.sport.object.turn_length
