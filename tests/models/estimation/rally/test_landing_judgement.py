"""Calls of landings against counts of simulated ones, and heights over the net against the flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr
from support.staged_rally import stage_rally

from models.core.rally import LandingHypothesis, Rally, RallyEvent, RallyEventKind
from models.estimation.rally.landing_hypotheses import find_first_touch, predict_landing
from models.estimation.rally.landing_judgement import judge_landing, judge_net
from models.physics.flight.flight_motion import fly
from models.sports.sport_catalogue import find_sports

BADMINTON, TENNIS, TABLE_TENNIS = (find_sports()[name] for name in ("badminton", "tennis", "table-tennis"))


def move_landing(rally: Rally, place: tuple[float, float], covariance: np.ndarray, weight: float = 1.0) -> Rally:
    """Put the landing elsewhere, with another error (2, 2) m^2 and probability."""
    whole = np.zeros((3, 3))
    whole[:2, :2] = covariance
    (one,) = rally.landings
    moved = replace(one, place=np.array([*place, 0.03]), covariance=whole, weight=weight)
    return replace(rally, landings=(moved,), no_landing=1 - weight)


@pytest.mark.parametrize(
    ("x", "verdict"), [(13.30, "in"), (13.399, "undecided"), (13.50, "out")], ids=["inside", "on the edge", "beyond"]
)
def test_a_landing_is_in_out_or_undecided_by_its_error(x: float, verdict: str) -> None:
    call = judge_landing(stage_rally(BADMINTON, (x, 3.0), sigma=(0.03, 0.02)))
    assert call.verdict == verdict
    assert call.line == "far end line"
    assert call.distance == pytest.approx(13.40 - x, abs=1e-6)
    assert call.distance_sigma == pytest.approx(0.03)
    assert (call.reason is None) == (verdict != "undecided")
    assert call.half == "far"


def test_the_place_of_contact_on_the_line_is_in() -> None:
    call = judge_landing(stage_rally(TENNIS, (23.77 - 0.005, 5.0), sigma=(0.001, 0.001)))
    assert call.verdict == "in"
    assert call.distance == pytest.approx(0.005)


def test_the_nearest_line_is_named_and_the_one_that_decides_the_probability_beside_it() -> None:
    """One camera knows the place along the court worse: a far end line may be nearer in standard deviations."""
    rally = stage_rally(BADMINTON, (11.4, 0.96), sigma=(1.5, 0.02))
    call = judge_landing(rally)
    assert (call.line, call.distance, call.distance_sigma) == (
        "left singles line",
        pytest.approx(0.5),
        pytest.approx(0.02),
    )
    assert call.rival is not None
    assert (call.rival.line, call.rival.distance, call.rival.sigma) == (
        "far end line",
        pytest.approx(2.0),
        pytest.approx(1.5),
    )
    assert call.probability == pytest.approx(ndtr(2.0 / 1.5) - ndtr((6.7 - 11.4) / 1.5), abs=1e-3)
    certain = judge_landing(stage_rally(BADMINTON, (11.4, 0.96), sigma=(0.3, 0.2)))
    assert (certain.line, certain.rival) == ("left singles line", None), "nothing lies within three sigma of the end"
    untrusted = judge_landing(replace(rally, flights=(replace(rally.flights[0], chi2=9.0),)))
    assert untrusted.rival is None, "its probability depends on no distance"
    beyond = judge_landing(stage_rally(BADMINTON, (13.9, 0.56), sigma=(0.02, 0.02)))
    assert (beyond.line, beyond.distance, beyond.rival) == ("far end line", pytest.approx(-0.5), None), (
        "not 10 cm inside"
    )


@pytest.mark.parametrize("seed", range(6))
def test_the_probability_is_the_share_of_simulated_landings_in_the_area(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corner = np.array([13.40, 0.46])  # of the singles court
    mean, root = corner + rng.normal(0, 0.05, 2), rng.normal(0, 0.06, (2, 2))
    rally = move_landing(stage_rally(BADMINTON, (13.0, 3.0)), tuple(mean), root @ root.T)
    call = judge_landing(rally)
    places = mean + rng.standard_normal((200_000, 2)) @ root.T
    inside = np.mean((places[:, 0] <= 13.40) & (places[:, 1] >= 0.46))
    assert call.probability == pytest.approx(inside, abs=0.005)
    assert call.probability + call.out_probability == pytest.approx(1.0)


def test_calls_are_right_as_often_as_they_say() -> None:
    rng = np.random.default_rng(11)
    base, right, stated = stage_rally(BADMINTON, (13.0, 3.0)), [], []
    for _ in range(400):
        true, sigma = 13.40 + rng.normal(0, 0.06), rng.uniform(0.01, 0.06)
        seen = true + rng.normal(0, sigma)
        call = judge_landing(move_landing(base, (seen, 3.0), np.diag([sigma, 0.02]) ** 2))
        if call.verdict != "undecided":
            right.append((call.verdict == "in") == (true <= 13.40))
            stated.append(max(call.probability, call.out_probability))
    assert len(right) > 100
    assert np.mean(right) >= np.mean(stated) - 3 * np.sqrt(0.05 / len(right))


def test_rival_landings_and_none_at_all_share_the_probability() -> None:
    rally = stage_rally(BADMINTON, (13.0, 3.0))
    (one,) = rally.landings
    far = LandingHypothesis(0.4, one.t, one.t_sigma, np.array([14.5, 3.0, 0.03]), one.covariance, True)
    call = judge_landing(replace(rally, landings=(replace(one, weight=0.6), far), no_landing=0.0))
    assert (call.verdict, call.reason) == ("undecided", "several")
    assert call.probability == pytest.approx(0.6, abs=1e-6)
    call = judge_landing(replace(rally, landings=(), no_landing=1.0))
    assert (call.verdict, call.reason, call.landing) == ("undecided", "no_landing", None)
    assert call.frames == (-1, -1)
    call = judge_landing(move_landing(rally, (13.0, 3.0), 1e-4 * np.eye(2), weight=0.5))
    assert (call.verdict, call.reason) == ("undecided", "no_landing")


def test_what_falls_back_into_the_own_half_is_out() -> None:
    rally = move_landing(stage_rally(BADMINTON, (13.0, 3.0)), (5.0, 3.0), 1e-4 * np.eye(2))
    call = judge_landing(rally)
    assert (call.verdict, call.line) == ("out", "net")
    unknown = replace(rally, events=rally.events[1:])  # the direction of the flight tells
    assert judge_landing(unknown).verdict == "out"


@pytest.mark.parametrize(
    ("start_y", "landing_y", "verdict"),
    [(2.0, 4.5, "in"), (4.0, 4.5, "out"), (4.0, 1.5, "in"), (3.05, 4.5, "undecided")],
)
def test_a_service_is_good_in_the_box_diagonally_opposite(start_y: float, landing_y: float, verdict: str) -> None:
    start = (4.0, start_y, 1.1)
    call = judge_landing(stage_rally(BADMINTON, (9.5, landing_y), start=start), "service-box")
    assert call.verdict == verdict
    if verdict == "undecided":
        assert call.reason == "hitter_unknown"


def test_a_tennis_service_past_the_service_line_is_out() -> None:
    rally = stage_rally(TENNIS, (18.6, 7.5), start=(0.2, 4.5, 2.6), climb=-0.5)
    call = judge_landing(rally, "service-box")
    assert (call.verdict, call.line) == ("out", "far service line")
    assert judge_landing(rally).verdict == "in"


def test_the_floor_beside_a_table_is_out() -> None:
    rally = stage_rally(TABLE_TENNIS, (2.5, 0.7))
    assert judge_landing(rally).verdict == "in"
    (one,) = rally.landings
    floor = replace(one, place=np.array([2.5, 0.7, TABLE_TENNIS.floor]))
    assert judge_landing(replace(rally, landings=(floor,))).verdict == "out"


def test_the_area_must_be_one_of_the_sport() -> None:
    with pytest.raises(ValueError, match="badminton has the areas singles, doubles, service-box; got 'squash'"):
        judge_landing(stage_rally(BADMINTON, (13.0, 3.0)), "squash")


def test_the_deciding_frames_surround_the_landing() -> None:
    rally = stage_rally(BADMINTON, (13.399, 3.0))
    first, last = judge_landing(rally).frames
    assert rally.t[first] <= rally.landings[0].t <= rally.t[last]
    assert last - first == 1


def test_the_height_over_the_net_is_that_of_the_flight() -> None:
    rally = stage_rally(TENNIS, (22.0, 5.0))
    (crossing,) = judge_net(rally)
    (flight,) = rally.flights
    place = fly(flight.parameters, np.array([crossing.t - flight.start]), 0.0).states[0]
    assert place[0] == pytest.approx(TENNIS.length / 2, abs=0.01)
    edge = float(TENNIS.net.height_at(place[[1]], TENNIS.width)[0])
    assert crossing.height == pytest.approx(place[2] - TENNIS.object.radius - edge, abs=0.005)
    assert crossing.over_probability > 0.99
    touch = replace(rally.events[0], kind="net", player="", t=crossing.t + 0.005, place=place[:3], probability=0.9)
    (touched,) = judge_net(replace(rally, events=(*rally.events, touch)))
    assert touched.is_touch, "a flight that meets another at a touch crosses the plane there too"


def test_the_error_of_the_height_is_that_of_simulated_flights() -> None:
    rng = np.random.default_rng(2)
    rally = stage_rally(TENNIS, (22.0, 5.0))
    (flight,) = rally.flights
    heights = []
    for _ in range(400):
        drawn = flight.parameters + np.sqrt(np.diag(flight.covariance)) * rng.standard_normal(len(flight.parameters))
        tau = np.linspace(0, flight.end - flight.start, 400)
        states = fly(drawn, tau, 0.0).states
        heights.append(np.interp(TENNIS.length / 2, states[:, 0], states[:, 2]))
    assert judge_net(rally)[0].height_sigma == pytest.approx(np.std(heights), rel=0.15)


def test_a_flight_that_nothing_explains_lands_anywhere() -> None:
    rally = stage_rally(BADMINTON, (13.0, 3.0))
    (flight,) = rally.flights
    for wrong in (
        replace(rally, flights=(replace(flight, chi2=9.0),)),
        replace(rally, flights=(replace(flight, chi2=float("nan")),)),
        replace(rally, is_used=rally.is_used & (rally.frame % 3 == 0)),
        move_landing(rally, (-12.0, 3.0), 1e-2 * np.eye(2)),  # behind the player who hit it
    ):
        call = judge_landing(wrong)
        assert (call.verdict, call.reason, call.probability) == ("undecided", "unexplained", 0.5)


def test_a_rally_that_is_mostly_unexplained_decides_nothing() -> None:
    rally = stage_rally(BADMINTON, (13.0, 3.0))
    (flight,) = rally.flights
    seconds = flight.end - flight.start
    for share, reason in ((0.5, "mostly_unexplained"), (0.7, None)):
        wrong = replace(flight, start=flight.start - seconds * (1 - share) / share, end=flight.start, chi2=9.0)
        call = judge_landing(replace(rally, flights=(wrong, flight)))
        assert call.reason == reason
        assert (call.verdict == "undecided") == (reason is not None)


def test_a_doubtful_last_hit_decides_nothing() -> None:
    rally = stage_rally(BADMINTON, (13.0, 3.0), sigma=(0.03, 0.02))
    hit = replace(rally.events[0], probability=0.6)
    call = judge_landing(replace(rally, events=(hit, *rally.events[1:])))
    assert call.verdict == "undecided"
    assert call.probability + call.out_probability == pytest.approx(0.6)
    assert call.reason == "hit_doubtful", "its place is 0.4 m inside"
    on_the_line = judge_landing(replace(stage_rally(BADMINTON, (13.4, 3.0)), events=(hit, *rally.events[1:])))
    assert on_the_line.reason == "close", "more doubtful than the hit"


def test_a_service_of_table_tennis_is_judged_where_it_touches_the_other_half() -> None:
    def event(kind: RallyEventKind, t: float, x: float) -> RallyEvent:
        return RallyEvent(kind, t, 0.01, np.array([x, 0.7, 0.02]), np.eye(3) * 1e-4, 1.0, 5.0, 0.1)

    served = (event("hit", 0.0, -0.2), event("bounce", 0.2, 0.6), event("bounce", 0.5, 2.2))
    touch = find_first_touch(served, 0, TABLE_TENNIS)
    assert touch is not None
    assert touch.place[0] == 2.2
    returned = (*served, event("hit", 0.7, 2.9), event("bounce", 0.9, 2.5))
    touch = find_first_touch(returned, 3, TABLE_TENNIS)
    assert touch is not None
    assert touch.t == 0.9, "only a service may touch the own half"


def test_a_landing_that_more_probably_does_not_happen_is_no_place() -> None:
    assert judge_landing(stage_rally(BADMINTON, (12.0, 3.0), no_landing=0.4)).landing is not None
    call = judge_landing(stage_rally(BADMINTON, (12.0, 3.0), no_landing=0.6))
    assert (call.verdict, call.reason, call.landing) == ("undecided", "no_landing", None)


def test_the_direction_of_a_flight_tells_the_half_no_better_than_its_speed_is_known() -> None:
    rally = replace(stage_rally(BADMINTON, (12.0, 3.0)), last_player=("", 0.0))
    rally = replace(rally, events=rally.events[1:])
    assert (judge_landing(rally).verdict, judge_landing(rally).half) == ("in", "far")
    (flight,) = rally.flights
    unsure = flight.covariance.copy()
    unsure[3, 3] = (2 * flight.parameters[3]) ** 2
    call = judge_landing(replace(rally, flights=(replace(flight, covariance=unsure),)))
    assert call.probability == pytest.approx(ndtr(0.5), abs=1e-3)
    assert not call.half


@pytest.mark.parametrize(("x", "least", "most"), [(29.0, 0.6, 1.0), (50.0, 0.0, 1e-3)], ids=["near", "beyond a hall"])
def test_a_flight_is_not_continued_through_the_walls(x: float, least: float, most: float) -> None:
    rally = stage_rally(TENNIS, (x, 3.0), climb=9.0)
    (flight,) = rally.flights
    landing = predict_landing(flight, TENNIS, flight.end - 0.2, 0.04)
    assert landing is not None
    assert least <= landing.weight <= most
