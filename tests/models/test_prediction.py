"""The rest of a shot: against closed forms of one ball, against its own ensemble, and without a look at the future."""

from __future__ import annotations

from dataclasses import replace
from math import erf, sqrt

import numpy as np
import pytest

from models.core.errors import TrackError
from models.core.fit_result import Trust
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.forecast.current_state import outlook_at
from models.estimation.forecast.ensemble_prediction import Prediction, predict
from models.estimation.forecast.forecast_check import hindsight
from models.estimation.forecast.state_estimate import PER_BALL, SHARED, Outlook, law_probabilities
from models.physics.billiards.parameters import CUSHION_LAWS

R, G, MU = 0.028575, 9.81, 0.01
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, R, 0.17, False)
GREEN = Trust("green", ())


def outlook_of(balls: list[tuple[float, float, float, float]], sigma: list[tuple[float, float]]) -> Outlook:
    """Balls that roll or lie: x, y, vx, vy; sigma of places (m) and velocities (m/s); all else is known."""
    mean = np.zeros(PER_BALL * len(balls) + SHARED)
    spread = np.zeros_like(mean)
    for k, (state, (place, velocity)) in enumerate(zip(balls, sigma, strict=True)):
        mean[PER_BALL * k : PER_BALL * k + 4] = state
        spread[PER_BALL * k : PER_BALL * k + 4] = place, place, velocity, velocity
    mean[-SHARED:] = np.log(0.2), np.log(MU), 0, 0, 1, 0, 0, 0, 0, 0.75, 0, 0.95, np.log(0.18), np.log(10.0)
    moving = np.array([state[2] != 0 or state[3] != 0 for state in balls])
    ids = tuple("abcdef"[: len(balls)])
    return Outlook(1.0, ids, TABLE, mean, np.diag(spread**2), moving, GREEN, np.full(4, 0.25))


def rolled(v: float, t: np.ndarray) -> np.ndarray:
    """m that a rolling ball goes in t (s)."""
    t = np.minimum(t, v / (MU * G))
    return np.asarray(v * t - MU * G * t**2 / 2)


def test_a_ball_that_rolls_alone_goes_where_the_closed_form_says() -> None:
    t = np.linspace(0, 3, 31)
    found = predict(outlook_of([(0.4, 0.6, 0.6, 0.0)], [(1e-3, 5e-3)]), 1.0 + t)
    np.testing.assert_allclose(found.path[:, 0, 0], 0.4 + rolled(0.6, t), atol=1e-9)
    np.testing.assert_allclose(found.path[:, 0, 1], 0.6, atol=1e-9)
    assert not found.ensemble.any()
    assert found.foretold == ()


def test_the_error_of_a_speed_grows_with_time_as_its_derivative_says() -> None:
    """Along the path dx = dx0 + dv t; across it the direction turns, dy = dy0 + dv s / v with s the way rolled."""
    t = np.linspace(0, 3, 7)
    found = predict(outlook_of([(0.4, 0.6, 0.6, 0.0)], [(1e-3, 5e-3)]), 1.0 + t)
    along = 1e-6 + (5e-3 * t) ** 2
    across = 1e-6 + (5e-3 * rolled(0.6, t) / 0.6) ** 2
    np.testing.assert_allclose(found.covariance[:, 0, 0, 0], along, rtol=1e-6)
    np.testing.assert_allclose(found.covariance[:, 0, 1, 1], across, rtol=1e-6)


def test_friction_and_slope_carry_their_errors_into_the_place() -> None:
    t = np.array([0.0, 1.0, 2.0])
    look = outlook_of([(0.4, 0.6, 0.6, 0.0)], [(0.0, 0.0)])
    covariance = look.covariance.copy()
    covariance[-SHARED + 1, -SHARED + 1] = 0.1**2
    covariance[-SHARED + 3, -SHARED + 3] = 0.5**2
    found = predict(replace(look, covariance=covariance), 1.0 + t)
    np.testing.assert_allclose(np.sqrt(found.covariance[:, 0, 0, 0]), 0.1 * MU * G * t**2 / 2, rtol=1e-5)
    # a slope across the path of 0.5 mm/m pushes with 5/7 g times that, and friction turns with the path
    pushed = 5 / 7 * G * 0.5e-3 * t**2 / 2
    assert np.all(np.abs(np.sqrt(found.covariance[1:, 0, 1, 1]) / pushed[1:] - 1) < 0.15)


def test_derivatives_and_ensemble_agree_while_the_motion_is_tame() -> None:
    look = outlook_of([(0.5, 0.6, 0.9, 0.0), (1.2, 0.61, 0.0, 0.0)], [(3e-4, 2e-3), (1e-4, 0.0)])
    found = predict(look, 1.0 + np.array([0.0, 0.5, 1.0, 1.6]), seed=1, draws=4000)
    assert not found.ensemble.any()
    assert [one.meeting for one in found.foretold] == [("ball", "a", "b")]
    for row in (1, 2, 3):
        for ball in range(2):
            drawn = np.cov(found.courses[:, row, ball].T)
            scale = max(np.trace(drawn), 1e-9)
            np.testing.assert_allclose(found.covariance[row, ball] / scale, drawn / scale, atol=0.08)


def test_the_probability_of_a_hit_is_that_of_the_offset_at_the_ball() -> None:
    """A ball that rolls straight past another one, 2 R + miss aside, with an unsure line."""
    miss, sigma = 2e-3, 4e-3
    look = outlook_of([(0.5, 0.6, 0.9, 0.0), (1.2, 0.6 + 2 * R + miss, 0.0, 0.0)], [(sigma, 0.0), (0.0, 0.0)])
    found = predict(look, 1.0 + np.linspace(0, 1.0, 6), draws=2000)
    exact = 0.5 * (1 - erf(miss / sigma / sqrt(2)))
    hit = {one.meeting: one.probability for one in found.foretold}[("ball", "a", "b")]
    assert hit == pytest.approx(exact, abs=3 * sqrt(exact * (1 - exact) / 2000))
    assert dict(found.first[0])[("ball", "a", "b")] == pytest.approx(hit)
    assert found.ensemble[-1]
    assert not found.ensemble[0]


def test_balls_that_multiply_errors_are_given_to_the_ensemble_and_never_come_back() -> None:
    balls = [(0.3, 0.6, 1.5, 0.0), (0.8, 0.62, 0.0, 0.0), (1.5, 0.6, 0.0, 0.0), (1.4, 0.9, 0.0, 0.0)]
    found = predict(outlook_of(balls, [(1e-3, 1e-2)] + [(5e-4, 0.0)] * 3), 1.0 + np.linspace(0, 3, 31))
    assert found.ensemble[-1]
    assert np.all(np.diff(found.ensemble.astype(int)) >= 0)
    assert np.all(np.isfinite(found.path))
    assert np.all(found.sigma[-1] >= 0)


def test_a_potted_ball_is_on_the_table_no_more() -> None:
    look = outlook_of([(0.4, 0.4, -0.9, -0.9)], [(2e-4, 1e-3)])
    found = predict(replace(look, table=replace(TABLE, pockets=True)), 1.0 + np.linspace(0, 2, 11))
    assert found.on_table[-1, 0] == 0.0
    assert np.isnan(found.path[-1, 0]).all()
    assert [(one.meeting, one.probability) for one in found.foretold] == [(("pocket", "a", "top-left"), 1.0)]


def test_a_ball_comes_to_rest_when_friction_has_used_its_speed() -> None:
    t = np.linspace(0, 3, 301)
    found = predict(outlook_of([(0.4, 0.6, 0.2, 0.0)], [(1e-4, 0.0)]), 1.0 + t)
    (rest,) = found.foretold
    assert (rest.meeting, rest.probability) == (("rest", "a", ""), 1.0)
    assert rest.t == pytest.approx(1.0 + 0.2 / (MU * G), abs=0.01)
    assert found.path[-1, 0, 0] == pytest.approx(0.4 + 0.2**2 / (2 * MU * G), abs=1e-6)


def test_cushions_that_let_the_spin_pass_speak_for_the_mirror() -> None:
    free, gripping, unknown = law_probabilities(0.0, 0.1), law_probabilities(1.2, 0.1), law_probabilities(0.5, 0.5)
    mirror = CUSHION_LAWS.index("mirror")
    assert free[mirror] > 0.8
    assert gripping[mirror] < 0.05
    assert np.all(unknown > 0.1)
    assert free.sum() == pytest.approx(1.0)


def test_one_seed_gives_one_prediction_and_another_seed_another() -> None:
    look = outlook_of([(0.5, 0.6, 0.9, 0.0), (1.2, 0.63, 0.0, 0.0)], [(2e-3, 1e-2), (1e-4, 0.0)])
    one, same, other = (predict(look, 1.0 + np.linspace(0, 2, 5), seed).courses for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_moments_before_the_outlook_are_refused() -> None:
    look = outlook_of([(0.5, 0.6, 0.9, 0.0)], [(2e-3, 1e-2)])
    with pytest.raises(ValueError, match="ascend"):
        predict(look, np.array([0.5, 1.5]))


SCENE = Scene(
    TABLE,
    Camera(np.array([[350.0, 0, 0, 30], [0, 350.0, 0, 30], [0, 0, 0, 1]]), 950, 505, 350 * TABLE.corners + 30,
           0.01 * np.eye(8), "cloth", 4.0, 0.3),
    np.array([40.0, -30.0, 10.0]), (),
)  # fmt: skip


def filmed(seed: int, seconds: float = 1.2) -> Tracks:
    """A ball that rolls towards the right cushion, and one that lies; 60 pictures a second, 1 mm of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 60)) / 60
    xy = np.stack([np.column_stack([0.4 + rolled(0.8, t), np.full_like(t, 0.6)]), np.tile([0.3, 0.3], (len(t), 1))], 1)
    shape = xy.shape[:2]
    sigma = np.full(shape, 1e-3)
    xy = xy + rng.normal(0, 1e-3, xy.shape)
    return Tracks(
        np.arange(len(t)), t, ("cue", "red"), ("cue", "red"), xy, 350 * xy + 30, sigma, sigma, np.zeros_like(xy),
        np.full(shape, 10.0), np.zeros((2, 3)),
    )  # fmt: skip


def prediction_of(tracks: Tracks, at: float = 0.8) -> Prediction:
    return predict(outlook_at(tracks, SCENE, at), at + np.array([0.0, 0.25, 1.0]))


def test_nothing_that_was_seen_later_is_used() -> None:
    tracks = filmed(0)
    wild = tracks.xy.copy()
    wild[tracks.t > 0.8] = [0.1, 1.1]
    poisoned = replace(tracks, xy=wild)
    np.testing.assert_array_equal(prediction_of(tracks).path, prediction_of(poisoned).path)
    np.testing.assert_array_equal(prediction_of(tracks).courses, prediction_of(poisoned).courses)


def test_a_rolling_ball_is_predicted_within_what_is_promised() -> None:
    inside = []
    for seed in range(12):
        found = prediction_of(filmed(seed))
        true = np.array([0.4 + rolled(0.8, np.array(1.8)), 0.6])
        inside.append(found.level(2, 0, true) <= 0.9)
        assert np.hypot(*(found.path[2, 0] - true)) < 0.06
    assert sum(inside) >= 9


def test_hindsight_holds_every_later_place_against_the_promise() -> None:
    tracks = filmed(1)
    look = outlook_at(tracks, SCENE, 0.8)
    later = tracks.t[tracks.t > 0.8 + 1e-9]
    after = hindsight(predict(look, np.append(0.8, later)), tracks)
    assert len(after.t) == 2 * len(later)
    assert np.all(after.error[after.ball == look.ids.index("red")] < 6e-3)
    assert np.mean(after.level <= 0.9) > 0.7


def test_too_little_that_was_seen_is_said() -> None:
    with pytest.raises(TrackError, match="at least 5"):
        outlook_at(filmed(0), SCENE, 0.02)
