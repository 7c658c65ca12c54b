"""Explanations of one clip weighed together."""

from dataclasses import replace

import numpy as np
import pytest
from support.staged_rally import stage_rally

from models.estimation.rally.explain_rally import RallyExplanations, combine_explanations, lower_by_rules
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.rally_revision import Doubt
from models.sports.badminton import SPORT as BADMINTON
from models.sports.tennis import SPORT as TENNIS


def test_a_doubt_about_a_bounce_lowers_its_landing() -> None:
    rally = stage_rally(TENNIS, (22.0, 5.0))
    (landing,) = rally.landings
    sure = combine_explanations(RallyExplanations((rally,), np.zeros(1), ()))
    doubtful = combine_explanations(RallyExplanations((rally,), np.zeros(1), (Doubt("bounce", landing.t, 0.0),)))
    elsewhere = combine_explanations(RallyExplanations((rally,), np.zeros(1), (Doubt("bounce", landing.t - 0.2, 0.0),)))
    assert sure.landings[0].weight == elsewhere.landings[0].weight == pytest.approx(1.0)
    assert doubtful.landings[0].weight == pytest.approx(0.5)  # the other explanation is as good
    assert doubtful.no_landing == pytest.approx(0.5)


def test_which_of_two_hits_of_one_player_was_real_does_not_matter_for_the_half_of_the_landing() -> None:
    """Nobody hits twice in a row, so one of the hits is none; the landing is good in the other half either way."""
    rally = stage_rally(BADMINTON, (12.0, 3.0))
    hit, landing = rally.events
    twice = replace(rally, events=(replace(hit, t=hit.t - 0.4, place=hit.place - [0.5, 0.0, 0.0]), hit, landing))
    combined = combine_explanations(RallyExplanations((twice,), np.zeros(1), ()))
    (last,) = [one for one in combined.events if one.t == hit.t]
    assert last.probability < 0.9
    call = judge_landing(combined)
    assert (call.verdict, call.probability > 0.95) == ("in", True)


def test_a_hit_within_a_gap_belongs_to_what_follows_it() -> None:
    """Nobody hits twice in a row, and what was lost for a while may have been hit back meanwhile."""
    rally = stage_rally(BADMINTON, (12.0, 3.0))
    (flight,) = rally.flights
    lost, seen = flight.start + 0.2, flight.start + 0.5
    flights = (replace(flight, end=lost), replace(flight, start=seen))
    far = replace(rally.events[0], player="far", place=np.array([11.0, 3.0, 2.0]))
    events = [
        rally.events[0],
        replace(far, t=seen - 0.02, probability=0.92),
        replace(far, t=seen + 0.3, probability=0.99),
    ]
    first, within, last = lower_by_rules(replace(rally, flights=flights), events)
    assert first.probability > 0.9
    assert within.probability < 0.1
    assert last.probability > 0.8
