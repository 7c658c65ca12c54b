"""Prediction of a shot against closed forms of one ball, against its own ensemble, and without later frames."""

from __future__ import annotations

import re
from dataclasses import replace
from math import erf, sqrt

import numpy as np
import pytest

from models.core.errors import TrackError
from models.core.fit_result import Trust
from models.core.naming import Naming
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.forecast.ensemble_prediction import ShotPrediction, forecast_shot
from models.estimation.forecast.forecast_check import check_prediction, estimate_state
from models.estimation.forecast.state_estimate import (
    PARAMETERS_PER_BALL,
    SHARED_COUNT,
    StateEstimate,
    law_probabilities,
)
from models.physics.billiards.contact_models import CUSHION_MODELS
from pipeline.actions.predict_shot import summarize_prediction

R, G, MU = 0.028575, 9.81, 0.01
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, R, 0.17, False)
GREEN = Trust("green", ())


def make_state(balls: list[tuple[float, float, float, float]], sigma: list[tuple[float, float]]) -> StateEstimate:
    """Balls that roll or rest: x, y, vx, vy; sigma of places (m) and velocities (m/s); everything else is certain."""
    mean = np.zeros(PARAMETERS_PER_BALL * len(balls) + SHARED_COUNT)
    spread = np.zeros_like(mean)
    for k, (state, (place, velocity)) in enumerate(zip(balls, sigma, strict=True)):
        mean[PARAMETERS_PER_BALL * k : PARAMETERS_PER_BALL * k + 4] = state
        spread[PARAMETERS_PER_BALL * k : PARAMETERS_PER_BALL * k + 4] = place, place, velocity, velocity
    mean[-SHARED_COUNT:] = np.log(0.2), np.log(MU), 0, 0, 1, 0, 0, 0, 0, 0.75, 0, 0.95, np.log(0.18), np.log(10.0)
    moving = np.array([state[2] != 0 or state[3] != 0 for state in balls])
    ids = tuple("abcdef"[: len(balls)])
    return StateEstimate(1.0, ids, TABLE, mean, np.diag(spread**2), moving, GREEN, np.full(4, 0.25))


def rolling_distance(v: float, t: np.ndarray) -> np.ndarray:
    """m that a rolling ball goes in t (s)."""
    t = np.minimum(t, v / (MU * G))
    return np.asarray(v * t - MU * G * t**2 / 2)


def test_a_ball_that_rolls_alone_goes_where_the_closed_form_says() -> None:
    t = np.linspace(0, 3, 31)
    prediction = forecast_shot(make_state([(0.4, 0.6, 0.6, 0.0)], [(1e-3, 5e-3)]), 1.0 + t)
    np.testing.assert_allclose(prediction.path[:, 0, 0], 0.4 + rolling_distance(0.6, t), atol=1e-9)
    np.testing.assert_allclose(prediction.path[:, 0, 1], 0.6, atol=1e-9)
    assert not prediction.is_ensemble.any()
    assert prediction.events == ()


def test_the_error_of_a_speed_grows_with_time_as_its_derivative_says() -> None:
    """Along the path dx = dx0 + dv t; across it the direction turns, dy = dy0 + dv s / v with the rolled distance s."""
    t = np.linspace(0, 3, 7)
    prediction = forecast_shot(make_state([(0.4, 0.6, 0.6, 0.0)], [(1e-3, 5e-3)]), 1.0 + t)
    along = 1e-6 + (5e-3 * t) ** 2
    across = 1e-6 + (5e-3 * rolling_distance(0.6, t) / 0.6) ** 2
    np.testing.assert_allclose(prediction.covariance[:, 0, 0, 0], along, rtol=1e-6)
    np.testing.assert_allclose(prediction.covariance[:, 0, 1, 1], across, rtol=1e-6)


def test_friction_and_slope_carry_their_errors_into_the_place() -> None:
    t = np.array([0.0, 1.0, 2.0])
    state = make_state([(0.4, 0.6, 0.6, 0.0)], [(0.0, 0.0)])
    covariance = state.covariance.copy()
    covariance[-SHARED_COUNT + 1, -SHARED_COUNT + 1] = 0.1**2
    covariance[-SHARED_COUNT + 3, -SHARED_COUNT + 3] = 0.5**2
    prediction = forecast_shot(replace(state, covariance=covariance), 1.0 + t)
    np.testing.assert_allclose(np.sqrt(prediction.covariance[:, 0, 0, 0]), 0.1 * MU * G * t**2 / 2, rtol=1e-5)
    # a slope across the path of 0.5 mm/m pushes with 5/7 g times that, and friction turns with the path
    pushed = 5 / 7 * G * 0.5e-3 * t**2 / 2
    assert np.all(np.abs(np.sqrt(prediction.covariance[1:, 0, 1, 1]) / pushed[1:] - 1) < 0.15)


def test_derivatives_and_ensemble_agree_while_the_motion_is_tame() -> None:
    state = make_state([(0.5, 0.6, 0.9, 0.0), (1.2, 0.61, 0.0, 0.0)], [(3e-4, 2e-3), (1e-4, 0.0)])
    prediction = forecast_shot(state, 1.0 + np.array([0.0, 0.5, 1.0, 1.6]), seed=1, draws=4000)
    assert not prediction.is_ensemble.any()
    assert [one.event for one in prediction.events] == [("ball", "a", "b")]
    for row in (1, 2, 3):
        for ball in range(2):
            drawn = np.cov(prediction.members[:, row, ball].T)
            scale = max(np.trace(drawn), 1e-9)
            np.testing.assert_allclose(prediction.covariance[row, ball] / scale, drawn / scale, atol=0.08)


def test_the_probability_of_a_hit_is_that_of_the_offset_at_the_ball() -> None:
    """A ball that rolls straight past another one, 2 R + offset aside, with an uncertain line."""
    miss, sigma = 2e-3, 4e-3
    state = make_state([(0.5, 0.6, 0.9, 0.0), (1.2, 0.6 + 2 * R + miss, 0.0, 0.0)], [(sigma, 0.0), (0.0, 0.0)])
    prediction = forecast_shot(state, 1.0 + np.linspace(0, 1.0, 6), draws=2000)
    exact = 0.5 * (1 - erf(miss / sigma / sqrt(2)))
    hit = {one.event: one.probability for one in prediction.events}[("ball", "a", "b")]
    assert hit == pytest.approx(exact, abs=3 * sqrt(exact * (1 - exact) / 2000))
    assert dict(prediction.first_contacts[0])[("ball", "a", "b")] == pytest.approx(hit)
    assert prediction.is_ensemble[-1]
    assert not prediction.is_ensemble[0]


def test_balls_that_multiply_errors_switch_to_the_ensemble_and_never_back() -> None:
    balls = [(0.3, 0.6, 1.5, 0.0), (0.8, 0.62, 0.0, 0.0), (1.5, 0.6, 0.0, 0.0), (1.4, 0.9, 0.0, 0.0)]
    prediction = forecast_shot(make_state(balls, [(1e-3, 1e-2)] + [(5e-4, 0.0)] * 3), 1.0 + np.linspace(0, 3, 31))
    assert prediction.is_ensemble[-1]
    assert np.all(np.diff(prediction.is_ensemble.astype(int)) >= 0)
    assert np.all(np.isfinite(prediction.path))
    assert np.all(prediction.sigma[-1] >= 0)


def test_a_potted_ball_is_on_the_table_no_more() -> None:
    state = make_state([(0.4, 0.4, -0.9, -0.9)], [(2e-4, 1e-3)])
    prediction = forecast_shot(replace(state, table=replace(TABLE, pockets=True)), 1.0 + np.linspace(0, 2, 11))
    assert prediction.on_table[-1, 0] == 0.0
    assert np.isnan(prediction.path[-1, 0]).all()
    assert [(one.event, one.probability) for one in prediction.events] == [(("pocket", "a", "top-left"), 1.0)]


def test_a_ball_comes_to_rest_when_friction_has_used_its_speed() -> None:
    t = np.linspace(0, 3, 301)
    prediction = forecast_shot(make_state([(0.4, 0.6, 0.2, 0.0)], [(1e-4, 0.0)]), 1.0 + t)
    (rest,) = prediction.events
    assert (rest.event, rest.probability) == (("rest", "a", ""), 1.0)
    assert rest.t == pytest.approx(1.0 + 0.2 / (MU * G), abs=0.01)
    assert prediction.path[-1, 0, 0] == pytest.approx(0.4 + 0.2**2 / (2 * MU * G), abs=1e-6)


def test_cushions_without_grip_favour_the_mirror_law() -> None:
    free, gripping, unknown = law_probabilities(0.0, 0.1), law_probabilities(1.2, 0.1), law_probabilities(0.5, 0.5)
    mirror = CUSHION_MODELS.index("mirror")
    assert free[mirror] > 0.8
    assert gripping[mirror] < 0.05
    assert np.all(unknown > 0.1)
    assert free.sum() == pytest.approx(1.0)


def test_one_seed_gives_one_prediction_and_another_seed_another() -> None:
    state = make_state([(0.5, 0.6, 0.9, 0.0), (1.2, 0.63, 0.0, 0.0)], [(2e-3, 1e-2), (1e-4, 0.0)])
    one, same, other = (forecast_shot(state, 1.0 + np.linspace(0, 2, 5), seed).members for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_moments_before_the_state_are_refused() -> None:
    state = make_state([(0.5, 0.6, 0.9, 0.0)], [(2e-3, 1e-2)])
    with pytest.raises(ValueError, match="ascend"):
        forecast_shot(state, np.array([0.5, 1.5]))


SCENE = Scene(
    TABLE,
    Camera(np.array([[350.0, 0, 0, 30], [0, 350.0, 0, 30], [0, 0, 0, 1]]), 950, 505, 350 * TABLE.corners + 30,
           0.01 * np.eye(8), "cloth", 4.0, 0.3),
    np.array([40.0, -30.0, 10.0]), (),
)  # fmt: skip


def make_filmed_tracks(seed: int, seconds: float = 1.2) -> Tracks:
    """A ball that rolls towards the right cushion, and one that rests; 60 fps, 1 mm of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 60)) / 60
    xy = np.stack(
        [np.column_stack([0.4 + rolling_distance(0.8, t), np.full_like(t, 0.6)]), np.tile([0.3, 0.3], (len(t), 1))], 1
    )
    shape = xy.shape[:2]
    sigma = np.full(shape, 1e-3)
    xy = xy + rng.normal(0, 1e-3, xy.shape)
    return Tracks(
        np.arange(len(t)), t, ("cue", "red"), ("cue", "red"), xy, 350 * xy + 30, sigma, sigma, np.zeros_like(xy),
        np.full(shape, 10.0), np.zeros((2, 3)),
    )  # fmt: skip


def prediction_of(tracks: Tracks, at: float = 0.8) -> ShotPrediction:
    return forecast_shot(estimate_state(tracks, SCENE, at), at + np.array([0.0, 0.25, 1.0]))


def test_no_later_frame_is_used() -> None:
    tracks = make_filmed_tracks(0)
    wild = tracks.xy.copy()
    wild[tracks.t > 0.8] = [0.1, 1.1]
    poisoned = replace(tracks, xy=wild)
    np.testing.assert_array_equal(prediction_of(tracks).path, prediction_of(poisoned).path)
    np.testing.assert_array_equal(prediction_of(tracks).members, prediction_of(poisoned).members)


def test_a_rolling_ball_is_predicted_within_its_interval() -> None:
    inside = []
    for seed in range(12):
        prediction = prediction_of(make_filmed_tracks(seed))
        true = np.array([0.4 + rolling_distance(0.8, np.array(1.8)), 0.6])
        inside.append(prediction.level(2, 0, true) <= 0.9)
        assert np.hypot(*(prediction.path[2, 0] - true)) < 0.06
    assert sum(inside) >= 9


def test_the_check_compares_every_later_place_with_the_prediction() -> None:
    tracks = make_filmed_tracks(1)
    state = estimate_state(tracks, SCENE, 0.8)
    later = tracks.t[tracks.t > 0.8 + 1e-9]
    after = check_prediction(forecast_shot(state, np.append(0.8, later)), tracks)
    assert len(after.t) == 2 * len(later)
    assert np.all(after.error[after.ball == state.ids.index("red")] < 6e-3)
    assert np.mean(after.level <= 0.9) > 0.7


def test_too_few_frames_raise_an_error() -> None:
    with pytest.raises(TrackError, match="at least 5"):
        estimate_state(make_filmed_tracks(0), SCENE, 0.02)


def test_a_probable_contact_has_its_time_and_a_resting_ball_is_touched_rather_than_touches() -> None:
    state = make_state([(0.4, 0.6, 0.8, 0.0), (1.0, 0.6, 0.0, 0.0)], [(1e-3, 1e-4), (1e-5, 0.0)])
    prediction = forecast_shot(state, 1.0 + np.linspace(0, 4, 9), draws=256)
    first, second = (ball["sentence"] for ball in summarize_prediction(prediction, 0, None, Naming())["balls"])
    assert re.match(r"A keeps moving, touches b first at 1\.7\d* s ± \d+\.?\d* ms", first)
    assert re.match(r"B is at rest until a touches it at 1\.7\d* s ± ", second)


@pytest.mark.parametrize(("gap", "least", "most"), [(1.7e-3, 0.0, 0.1), (0.7e-3, 0.1, 0.5)])
def test_a_ball_that_is_rather_not_touched_ends_where_it_lies_in_every_output(
    gap: float, least: float, most: float
) -> None:
    resting = (1.0, 0.6 + 2 * R + gap, 0.0, 0.0)
    state = make_state([(0.4, 0.6, 0.8, 0.0), resting], [(1e-3, 1e-4), (1e-5, 0.0)])
    prediction = forecast_shot(state, 1.0 + np.linspace(0, 4, 9), draws=1000)
    assert least < (touched := sum(p for _, p in prediction.first_contacts[1])) < most
    rest = [one for one in prediction.events if one.event == ("rest", "b", "")]
    assert all(one.probability <= touched and one.t_low > 1.5 for one in rest), "nothing else moved it"
    assert np.linalg.norm(prediction.path[-1, 1] - resting[:2]) > 1e-4, "the mean of all plays lies elsewhere"
    ball = summarize_prediction(prediction, 0, None, Naming())["balls"][1]
    assert (ball["end"]["x"], ball["end"]["y"]) == pytest.approx(resting[:2], abs=1e-6)
    assert ball["sentence"].startswith("B stays at rest (")
    assert ("unless a touches it" in ball["sentence"]) == (touched >= 0.1)
    assert f"{100 * (TABLE.width - resting[1]):.1f} cm" in ball["sentence"]
