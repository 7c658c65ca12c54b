"""A ball that rolls on a table ends the rally: who has it on the own half has lost, whoever hit it last."""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from support.staged_rally import FPS, stage_rally

from models.core.constants import GRAVITY
from models.core.corrections import BallMark, BallPlace
from models.core.errors import OptionError
from models.core.rally import BallCandidates, Rally
from models.core.typing import FloatArray
from models.estimation.rally.flight_observations import EventMark
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.point_judgement import judge_point
from models.estimation.rally.rolling_ball import end_at_roll, find_last_roll
from models.sports.sport_catalogue import find_sports
from pipeline.actions.predict_rally import state_flight_prediction
from pipeline.reporting.text.stroke_sentences import format_point

TABLE_TENNIS = find_sports()["table-tennis"]
NOISE_PX = 0.7


def append_places(rally: Rally, xyz: FloatArray) -> Rally:
    """Append frames that show the ball at places (N, 3), m, with noise."""
    count = len(rally.t) + len(xyz)
    noise = NOISE_PX * np.random.default_rng(4).standard_normal((len(xyz), 2))
    px = np.concatenate([rally.px, rally.scene.camera.to_pixels(xyz) + noise])
    return replace(
        rally, frame=np.arange(count), t=np.arange(count) / FPS, px=px, px_sigma=np.full((count, 2), NOISE_PX),
        streak=np.zeros((count, 2)), is_used=np.isfinite(px[:, 0]),
    )  # fmt: skip


def stage_roll(
    speed: tuple[float, float] = (-0.2, -1.2), x: float = 1.2, height: float = 0.02, gap: float = 0.0, y: float = 1.4
) -> Rally:
    """Build a rally of a stroke by the left player; so many s after it, the ball moves evenly over the left half."""
    rally = stage_rally(TABLE_TENNIS, (x + 0.05, y), climb=1.0, frames=100)
    rows = slice(0, int(np.ceil((rally.flights[0].end + gap) * FPS)))
    names = ("frame", "t", "px", "px_sigma", "streak", "is_used")
    rally = replace(rally, **{name: getattr(rally, name)[rows] for name in names})
    t = np.arange(20) / FPS
    places = np.column_stack([x + speed[0] * t, y + speed[1] * t, np.full(len(t), height)])
    return append_places(replace(rally, events=rally.events[:1], landings=(), no_landing=1.0), places)


def list_candidates(rally: Rally, score: float) -> BallCandidates:
    seen = np.flatnonzero(np.isfinite(rally.px[:, 0]))
    one = np.ones(len(seen))
    return BallCandidates(rally.frame[seen], rally.px[seen], np.zeros((len(seen), 2)), score * one, one, one)


def test_a_ball_that_rolls_on_the_own_half_loses_the_point_whoever_hit_it_last() -> None:
    rally = stage_roll()
    doubtful = replace(rally, events=(replace(rally.events[0], probability=0.6),))
    ended = end_at_roll(doubtful, list_candidates(rally, 0.9))
    (landing,) = ended.landings
    assert landing.is_rolling
    np.testing.assert_allclose(landing.place[:2], [1.2, 1.4], atol=0.05)
    call = judge_landing(ended)
    assert call.verdict == "undecided"  # where it would have been good depends on who hit it
    winner, chance = judge_point(ended, call)
    assert winner == "right"
    assert 0.99 < chance < 0.999
    point = format_point(ended, call)
    assert point.headline == "The right player won the last point: the ball stayed on the left half."
    assert point.is_decided
    assert "99.7 %" in point.confidence


def test_what_looks_like_no_ball_decides_nothing_by_rolling() -> None:
    rally = stage_roll()
    ended = end_at_roll(rally, list_candidates(rally, 0.3))
    assert not format_point(ended, judge_landing(ended)).is_decided


@pytest.mark.parametrize("speed", [(0.0, 0.0), (-3.5, 0.0)], ids=["a mark of the table", "too fast"])
def test_marks_and_fast_things_do_not_roll(speed: tuple[float, float]) -> None:
    assert find_last_roll(stage_roll(speed, x=2.6)) is None


def test_a_flight_over_the_table_is_no_roll() -> None:
    rally = stage_rally(TABLE_TENNIS, (1.9, 0.8), climb=2.0)
    assert find_last_roll(rally) is None
    t = np.arange(12) / FPS
    lob = np.column_stack([1.0 + 0.8 * t, 0.3 + 0.4 * t, 0.2 + 2.3 * t - GRAVITY / 2 * t**2])
    assert find_last_roll(append_places(rally, lob)) is None


def test_a_roll_before_the_last_hit_ends_nothing() -> None:
    rally = stage_roll()
    late = replace(rally, events=(replace(rally.events[0], t=float(rally.t[-1]) + 0.1),))
    assert end_at_roll(late, list_candidates(late, 0.9)) is late


def test_a_flight_that_was_fitted_to_the_roll_goes_with_its_events() -> None:
    rally = stage_roll()
    begin = float(rally.t[-20])
    bogus = replace(rally.flights[0], start=begin - 0.04, end=float(rally.t[-1]))
    event = replace(rally.events[0], t=begin - 0.04)
    ended = end_at_roll(
        replace(rally, flights=(*rally.flights, bogus), events=(*rally.events, event)), list_candidates(rally, 0.9)
    )
    assert [one.start for one in ended.flights] == [one.start for one in rally.flights]
    assert [one.t for one in ended.events] == [one.t for one in rally.events]


@pytest.mark.parametrize("gap", [0.3, 0.8])
def test_the_probability_of_a_roll_falls_as_that_of_no_hit_while_it_is_unseen(gap: float) -> None:
    """Hits come at 0.8 per second of play; up to a frame and a half between two places, nothing is missed."""
    rally = stage_roll(gap=gap)
    (landing,) = end_at_roll(rally, list_candidates(rally, 0.9)).landings
    unseen = rally.t[-20] - rally.flights[0].end - 1.5 / FPS
    assert landing.weight == pytest.approx(0.997 * np.exp(-0.8 * unseen), abs=1e-3)
    ended = replace(rally, landings=(landing,), no_landing=1 - landing.weight)
    assert not format_point(ended, judge_landing(ended)).is_decided


@pytest.mark.parametrize("gap", [1.0, 2.0])
def test_a_ball_that_is_rolled_back_after_a_while_ends_nothing(gap: float) -> None:
    """From 0.87 s on, a hit in between is more probable than none."""
    rally = stage_roll(gap=gap)
    assert find_last_roll(rally) is not None
    assert end_at_roll(rally, list_candidates(rally, 0.9)) is rally


def test_a_roll_begins_where_the_last_flight_leads() -> None:
    rally = stage_roll(x=0.3, speed=(0.5, -0.5))
    assert end_at_roll(rally, list_candidates(rally, 0.9)) is not rally
    far = replace(rally.flights[0], parameters=rally.flights[0].parameters + np.eye(13)[1] * 1.2)
    away = replace(rally, flights=(far,))
    assert end_at_roll(away, list_candidates(away, 0.9)) is away


def test_what_moves_evenly_through_the_net_is_no_roll() -> None:
    middle = TABLE_TENNIS.length / 2
    assert find_last_roll(stage_roll((1.0, 0.0), x=middle - 0.9)) is not None
    assert find_last_roll(stage_roll((1.0, 0.0), x=middle - 0.4)) is None


def test_a_ball_that_lies_takes_no_time() -> None:
    """Every place is added to a path once; adding each for every end took a minute for 400 frames."""
    rally = append_places(stage_roll(), np.tile([1.0, 0.44, 0.02], (800, 1)))
    begun = process_time()
    rows = find_last_roll(rally)
    assert process_time() - begun < 6.0
    assert rows is not None
    assert rally.t[rows[0]] == pytest.approx(rally.t[-820], abs=0.1)


def mark_event(t: float, is_there: bool = True) -> EventMark:
    return EventMark("hit", t, 0.5 / FPS, 2.5 / FPS, is_there)


def test_a_marked_event_comes_before_a_roll() -> None:
    rally = stage_roll()
    candidates = list_candidates(rally, 0.9)
    for off in (-0.05, 0.2, 1.0):  # just before it begins, in it, and after it
        mark = mark_event(float(rally.t[-20]) + off)
        assert end_at_roll(rally, candidates, (), (mark,)) is rally
    for harmless in (mark_event(0.4), mark_event(float(rally.t[-10]), is_there=False)):
        assert end_at_roll(rally, candidates, (), (harmless,)) is not rally


def test_a_place_that_is_no_ball_is_no_part_of_a_roll() -> None:
    rally = stage_roll()
    candidates, at = list_candidates(rally, 0.9), rally.px[-10]
    for frame, off, is_same in ((-10, 0.0, True), (-10, 20.0, False), (10, 0.0, False)):
        mark = BallMark("false", BallPlace(int(rally.frame[frame]), float(at[0] + off), float(at[1])))
        assert (end_at_roll(rally, candidates, (mark,)) is rally) == is_same


def test_contacts_before_a_roll_stay_where_their_flight_goes() -> None:
    """A touch of the net after which the ball mostly rolls, and a bounce with which the last flight ends, happened."""
    rally = stage_roll()
    begin = float(rally.t[-20])
    hit, flight = rally.events[0], rally.flights[0]
    touch = replace(hit, kind="net", t=begin - 0.06, player="")
    bounce = replace(hit, kind="bounce", t=flight.end, player="")
    dropped = replace(flight, start=touch.t, end=float(rally.t[-1]))
    cut = replace(flight, end=touch.t)
    touched = replace(rally, flights=(cut, dropped), events=(hit, touch))
    assert end_at_roll(touched, list_candidates(rally, 0.9)).events == (hit, touch)
    bounced = replace(rally, events=(hit, bounce))
    assert end_at_roll(bounced, list_candidates(rally, 0.9)).events == (hit, bounce)


def test_who_hit_last_is_known_anew_where_a_hit_goes() -> None:
    rally = stage_roll()
    begin = float(rally.t[-20])
    bogus = replace(rally.flights[0], start=begin - 0.04, end=float(rally.t[-1]))
    false = replace(rally.events[0], t=begin - 0.04, player="right", probability=0.7)
    wrong = replace(rally, flights=(*rally.flights, bogus), events=(*rally.events, false), last_player=("right", 0.7))
    assert end_at_roll(wrong, list_candidates(rally, 0.9)).last_player == ("left", 1.0)


def test_the_place_of_a_roll_is_as_uncertain_as_the_camera() -> None:
    rally = stage_roll()
    camera = rally.scene.camera
    sure = replace(rally, scene=replace(rally.scene, camera=replace(camera, covariance=0 * camera.covariance)))
    spread = np.zeros((8, 8))
    spread[0, 0] = 0.1**2  # the camera stands 0.1 m farther along the court, and so does all that it sees
    moved = replace(rally, scene=replace(rally.scene, camera=replace(camera, covariance=spread)))
    own, shared = (end_at_roll(one, list_candidates(rally, 0.9)).landings[0].covariance for one in (sure, moved))
    np.testing.assert_allclose((shared - own)[:2, :2], [[0.01, 0], [0, 0]], atol=1e-4)


def test_a_prediction_from_a_roll_says_that_nothing_flies() -> None:
    rally = stage_roll()
    ended = end_at_roll(rally, list_candidates(rally, 0.9))
    with pytest.raises(OptionError, match=r"nothing flies: from .* on the ball rolls on the left half"):
        state_flight_prediction(ended, 1.0, None)


def test_the_probability_of_a_point_contains_that_of_the_last_player_who_hit() -> None:
    """Several hits of one player may each be doubtful; the sentence states what the point rests on."""
    rally = stage_rally(TABLE_TENNIS, (2.2, 0.8), climb=2.0)
    doubtful = replace(rally, events=(replace(rally.events[0], probability=0.78), rally.events[1]))
    call = judge_landing(doubtful)
    assert judge_point(doubtful, call)[1] == pytest.approx(0.78, abs=1e-3)
    confidence = format_point(doubtful, call).confidence
    assert "These include the probability that the left player hit it last: 78 %." in confidence
    assert not format_point(doubtful, call).is_decided
    several = replace(doubtful, last_player=("left", 0.95))
    assert judge_point(several, judge_landing(several))[1] == pytest.approx(0.95, abs=1e-3)
    point = format_point(several, judge_landing(several))
    assert point.is_decided
    assert "78 %" not in point.confidence


def test_a_ball_that_comes_down_on_the_half_of_its_hitter_did_not_cross_the_net() -> None:
    rally = stage_rally(find_sports()["tennis"], (9.0, 5.0))
    point = format_point(rally, judge_landing(rally))
    assert point.headline == "The far player won the last point: the ball did not cross the net."
