"""The rules of each sport as a prior of sequences: what may follow what, and what is left of a chance that may not."""

import numpy as np
import pytest

from models.estimation.rally.event_chances import DEPARTURE
from models.estimation.rally.play_order import judge_order, locate_event, start_play, weigh_order
from models.sports.sport_catalogue import find_sports

SPORTS = find_sports()


def place(sport, spots):
    """Place events: `a` and `b` in the halves of the two players, `f` on the floor beside a table."""
    x = np.array([{"a": 0.1, "b": 0.9, "f": 1.2}[spot] * sport.length for spot in spots])
    return locate_event(x, np.full(len(x), 1e-3), np.array([spot == "f" for spot in spots]), sport)


def weigh(name, kinds, spots):
    """Weigh a sequence such as `hbh`: hit, bounce, hit; `n` is the net."""
    sport, names = SPORTS[name], {"h": "hit", "b": "bounce", "n": "net"}
    is_new = np.arange(len(kinds)) == 0
    return weigh_order(tuple(names[kind] for kind in kinds), place(sport, spots), is_new, sport)


@pytest.mark.parametrize(
    ("name", "kinds", "spots"),
    [
        ("badminton", "hhhhb", "ababa"),
        ("badminton", "hnb", "aaa"),
        ("tennis", "hbhbhhb", "abbaaba"),
        ("tennis", "hnbh", "abbb"),
        ("tennis", "hbbb", "abbb"),
        ("table-tennis", "hbbhbhbb", "aabbaabf"),
        ("table-tennis", "bhbbhb", "aaabbf"),
    ],
)
def test_play_by_the_rules_costs_no_more_than_where_it_begins(name, kinds, spots):
    assert weigh(name, kinds, spots) > np.log(0.08)


@pytest.mark.parametrize(
    ("name", "kinds", "spots"),
    [
        ("badminton", "hbh", "abb"),  # on after a landing
        ("badminton", "hhh", "aab"),  # twice by the same player
        ("tennis", "hbbh", "abbb"),  # after two bounces
        ("tennis", "hhb", "aab"),
        ("table-tennis", "hbbhh", "aabba"),  # a volley
        ("table-tennis", "hbbhbbhb", "aabbaaab"),  # two bounces
    ],
)
def test_play_against_the_rules_costs_a_departure(name, kinds, spots):
    assert weigh(name, kinds, spots) < np.log(2 * DEPARTURE)


def test_five_hits_of_one_player_are_not_believed_however_sure_each_is():
    for sport in SPORTS.values():
        chances = judge_order(("hit",) * 5, place(sport, "aaaaa"), np.full(5, 0.999), sport)
        assert (chances < 0.9).all()
        assert chances[1:].mean() < 0.7


def test_a_doubtful_half_leaves_hits_their_chances():
    sport = SPORTS["tennis"]
    nowhere = locate_event(np.full(4, sport.length / 2), np.full(4, 30.0), np.zeros(4, bool), sport)
    assert judge_order(("hit",) * 4, nowhere, np.full(4, 0.99), sport).min() > 0.95


def test_what_was_lost_may_have_been_hit_back():
    sport = SPORTS["badminton"]
    where, kinds = place(sport, "aa"), ("hit", "hit")
    seen, lost = (weigh_order(kinds, where, np.array([True, is_lost]), sport) for is_lost in (False, True))
    assert lost > seen + 3


def test_play_may_begin_in_the_states_that_a_sport_has():
    assert {name: int((start_play(sport) > 0).sum()) for name, sport in SPORTS.items()} == {
        "badminton": 7, "tennis": 7, "table-tennis": 9,
    }  # fmt: skip
    for sport in SPORTS.values():
        assert start_play(sport).sum() == pytest.approx(1)
