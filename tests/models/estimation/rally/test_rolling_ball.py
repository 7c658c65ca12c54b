"""A ball that rolls on a table ends the rally: who has it on the own half has lost, whoever hit it last."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.staged_rally import FPS, stage_rally

from models.core.constants import GRAVITY
from models.core.rally import BallCandidates, Rally
from models.core.typing import FloatArray
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.point_judgement import judge_point
from models.estimation.rally.rolling_ball import end_at_roll, find_last_roll
from models.sports.sport_catalogue import find_sports
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


def stage_roll(speed: tuple[float, float] = (-0.2, -1.2), x: float = 1.2, height: float = 0.02) -> Rally:
    """Build a rally of a stroke by the left player, after which the ball moves evenly over the left half."""
    rally = stage_rally(TABLE_TENNIS, (1.9, 0.8), climb=2.0)
    t = np.arange(20) / FPS
    places = np.column_stack([x + speed[0] * t, 1.4 + speed[1] * t, np.full(len(t), height)])
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
