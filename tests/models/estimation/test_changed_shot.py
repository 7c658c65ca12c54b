"""Changes of a stroke, what scores, and plays of a shot."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_pot import RED, SCENE, TARGET, play_pot

from models.core.events import Events
from models.core.fit_result import ShotNumber, ShotNumbers
from models.estimation.changed_shot import (
    ChangedShot,
    PlayerSpread,
    ShotGoal,
    StrokeChange,
    StruckEnsemble,
    StruckMember,
    change_stroke,
    group_by_ball,
    is_scored,
    measure_stroke,
    play_changed_shot,
)
from models.estimation.forecast.ensemble_prediction import EventKey
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from pipeline.actions.play_otherwise import list_play_times, summarize_changed_shot

R = 0.028575
STATE = np.array([0.5, 0.6, 2.0, 0.0, 0.0, 0.6 * 2.0 / R, -0.3 * 2.0 / R])
IDS = ("cue", "yellow", "red")
EXACT = PlayerSpread()
NONE = np.empty(0)
NONE_OF_FOUR = np.full(4, np.nan)
NOTHING = Events((), NONE, NONE, NONE, (), (), np.empty((0, 2)), NONE, NONE, NONE, NONE)
T = np.linspace(0, 3, 31)


def shares_of(state: np.ndarray) -> tuple[float, float, float, float]:
    """Speed, direction, top and side spin of a state."""
    speed = float(np.hypot(*state[2:4]))
    top = R * float(state[5] * state[2] - state[4] * state[3]) / speed**2
    return speed, float(np.degrees(np.arctan2(state[3], state[2]))), top, -R * float(state[6]) / speed


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (StrokeChange(), (2.0, 0.0, 0.6, 0.3)),
        (StrokeChange(speed_factor=0.9), (1.8, 0.0, 0.6, 0.3)),
        (StrokeChange(speed=3.0, angle=10.0), (3.0, 10.0, 0.6, 0.3)),
        (StrokeChange(side_added=-0.5, top_added=-0.7), (2.0, 0.0, -0.1, -0.2)),
        (StrokeChange(side=0.0, top=1.0, angle=-90.0), (2.0, -90.0, 1.0, 0.0)),
    ],
)
def test_a_change_keeps_what_it_does_not_name(change: StrokeChange, expected: tuple[float, ...]) -> None:
    assert shares_of(change_stroke(STATE, R, change, 1.0, 0.0)) == pytest.approx(expected, abs=1e-9)


def test_strokes_of_a_player_scatter_by_the_spread() -> None:
    drawn = PlayerSpread(0.03, 0.5).draw(np.random.default_rng(0), 4000)
    assert drawn.mean(axis=0) == pytest.approx([1.0, 0.0], abs=0.03)
    assert drawn.std(axis=0) == pytest.approx([0.03, 0.5], rel=0.05)


def contacts(*own: EventKey) -> list[list[tuple[float, EventKey]]]:
    """Contacts of the cue ball; the others have none."""
    return [[(0.1 * k, event) for k, event in enumerate(own)], [], []]


def test_a_contact_of_two_balls_belongs_to_both() -> None:
    strike, rest = ("strike", "cue", ""), ("rest", "red", "")
    pot, foreign = ("pocket", "yellow", "top"), ("ball", "green", "yellow")
    events = [(0.0, strike), (0.1, ("ball", "cue", "red")), (0.2, pot), (0.3, foreign), (0.4, rest)]
    cue, yellow, red = group_by_ball(events, IDS)
    assert cue == ((0.1, ("ball", "cue", "red")),)
    assert red == ((0.1, ("ball", "red", "cue")),)
    assert yellow == ((0.2, pot), (0.3, ("ball", "yellow", "green")))


YELLOW, RED_BALL, CUSHION = ("ball", "cue", "yellow"), ("ball", "cue", "red"), ("cushion", "cue", "left")


@pytest.mark.parametrize(
    ("game", "own", "scores"),
    [
        ("carom", (YELLOW, RED_BALL), True),
        ("carom", (YELLOW, YELLOW), False),
        ("three-cushion", (YELLOW, CUSHION, CUSHION, RED_BALL), False),
        ("three-cushion", (CUSHION, YELLOW, CUSHION, CUSHION, RED_BALL), True),
        ("three-cushion", (YELLOW, RED_BALL, CUSHION, CUSHION, CUSHION), False),
    ],
)
def test_a_carom_needs_both_balls_and_its_cushions(game: str, own: tuple[EventKey, ...], scores: bool) -> None:
    assert is_scored(contacts(*own), IDS, 0, ShotGoal(game)) is scores  # type: ignore[arg-type]


def test_a_potted_cue_ball_never_scores() -> None:
    order = contacts(("pocket", "cue", "top"))
    order[2].append((0.5, ("pocket", "red", "top-left")))
    assert not is_scored(order, IDS, 0, ShotGoal("pot"))
    assert is_scored([[], [], order[2]], IDS, 0, ShotGoal("pot", "red", "top-left"))
    assert not is_scored([[], [], order[2]], IDS, 0, ShotGoal("pot", "red", "top"))


def make_ensemble(count: int) -> StruckEnsemble:
    shot = play_pot()
    member = StruckMember(shot.balls, shot.physics, np.zeros(4), NO_CORRECTION, np.zeros((0, 5)))
    return StruckEnsemble(0.2, ("cue", "red"), 0, SCENE.table, (member,) * count, True)


def play(change: StrokeChange, spread: PlayerSpread = EXACT, seed: int = 0, count: int = 60) -> ChangedShot:
    return play_changed_shot(make_ensemble(count), change, spread, ShotGoal("pot"), T, seed)


def test_a_what_if_states_the_stroke_of_the_run_and_where_it_states_none_that_of_the_plays() -> None:
    change, ensemble = StrokeChange(speed_factor=0.9, top_added=0.2, side=0.3), make_ensemble(2)
    stated = (
        ShotNumber("cue_speed", 2.29, 0.02, "m/s", True, "cue"),
        ShotNumber("top_spin_share", -0.31, 0.01, "", True, "cue"),
        ShotNumber("side_spin_share", float("nan"), 0.5, "", False, "cue"),
    )
    numbers, shot = ShotNumbers(0.2, "cue", "red", "unknown", (), (), (), stated), play(change)
    document = summarize_changed_shot(
        ensemble, change, EXACT, "none", ShotGoal("pot"), shot, shot, NOTHING, (1.0, 6.0), [numbers]
    )
    real, changed = document["stroke"]["real"], document["stroke"]["changed"]
    assert real["observable"] == ["speed", "top"]
    balls = ensemble.members[0].balls
    assert (real["speed"], real["top"], real["speed_sigma"]) == (2.29, -0.31, 0.02)
    assert real["side"] == pytest.approx(measure_stroke(balls.state[0], float(balls.radius[0]))[1])
    assert (changed["speed"], changed["top"], changed["side"]) == pytest.approx((0.9 * 2.29, -0.11, 0.3))


@pytest.mark.parametrize(("filmed", "end"), [(2.0, 6.0), (7.93, 7.94)])
def test_a_play_lasts_as_long_as_the_film_so_that_it_can_score_whatever_that_shows(filmed: float, end: float) -> None:
    assert list_play_times(filmed)[-1] == pytest.approx(end)


@pytest.mark.parametrize("change", [StrokeChange(), StrokeChange(angle=2.0)])
def test_the_events_of_the_real_shot_are_those_of_the_film(change: StrokeChange) -> None:
    values = np.array([0.2, 0.7, 0.8, 1.5])
    film = Events(("strike", "ball", "pocket", "ball"), values, values / 128, 60 * values, ("cue", "cue", "red", "cue"),
                  ("", "red", "top", "red"), np.zeros((4, 2)), np.array([1.0, 0.9, 0.6, 1.0]), NONE_OF_FOUR,
                  NONE_OF_FOUR, NONE_OF_FOUR)  # fmt: skip
    strokes = [ShotNumbers(t, "cue", "red", "unknown", (), (), (), ()) for t in (0.2, 1.4)]
    ensemble, shot = make_ensemble(2), play(change, count=2)
    document = summarize_changed_shot(
        ensemble, change, EXACT, "none", ShotGoal("pot"), shot, shot, film, (2.0, 6.0), strokes
    )
    filmed = [(one["kind"], one["t"], one["t_sigma"], one["probability"]) for one in document["real"]["events"]]
    assert filmed == [("ball", 0.7, 0.7 / 128, 0.9), ("pocket", 0.8, 0.8 / 128, 0.6)]
    assert document["real"]["scored"]
    assert (document["changed"]["events"] == document["real"]["events"]) == (change == StrokeChange())


def test_the_shot_as_it_was_scores_and_one_aimed_elsewhere_does_not() -> None:
    real, aside = play(StrokeChange()), play(StrokeChange(angle=2.0))
    assert real.scored.all()
    assert not aside.scored.any()
    assert 0.9 < real.probability < 1.0
    assert np.isnan(real.members[:, -1, 1]).all()
    assert {one.event for one in real.events} >= {("ball", "cue", "red"), ("pocket", "red", "bottom-right")}


def test_the_spread_of_a_player_costs_pots_and_a_seed_repeats_them() -> None:
    wild = PlayerSpread(0.02, 0.6)
    one, same, other = (play(StrokeChange(), wild, seed, 200) for seed in (1, 1, 2))
    assert 0.1 < one.probability < 0.9
    np.testing.assert_array_equal(one.members, same.members)
    assert not np.array_equal(one.members, other.members)
    assert one.probability_sigma == pytest.approx(np.sqrt(one.probability * (1 - one.probability) / 202))


def test_the_pot_of_the_tests_is_a_cut_to_the_right() -> None:
    assert np.hypot(*(TARGET - RED)) < 0.7
