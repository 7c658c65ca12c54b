"""The answers of a shot summary: first contact, time, speeds, later motion, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.events import Events
from models.core.fit_result import Fit, RackBreak, ShotNumber, ShotNumbers
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.estimation.contact_test.call_answers import CallAnswer
from pipeline.reporting.text.call_sentences import format_score
from pipeline.reporting.text.shot_summary import ShotSummary, summarize_shots
from pipeline.reporting.text.text_formatting import name_event

T = np.linspace(0, 2, 61)
TOUCH = 0.8


def make_shot(after: tuple[float, float], cushion: float | None = None) -> tuple[Tracks, Fit]:
    """White is struck at 0.2 s, goes along x at 1 m/s, touches red at 0.8 s and goes on with velocity `after` (m/s)."""
    place = np.array([1.0, 0.5])
    rows = [
        (0, 0.0, 0.2, [0.4, 0.5], [0.0, 0.0]),
        (0, 0.2, TOUCH, [0.4, 0.5], [1.0, 0.0]),
        (0, TOUCH, 2.0, place, after),
        (1, 0.0, TOUCH, [1.06, 0.5], [0.0, 0.0]),
        (1, TOUCH, 2.0, [1.06, 0.5], [0.7, 0.0]),
    ]
    ball, start, end, x, v = (list(column) for column in zip(*rows, strict=True))
    position = np.zeros((5, 4, 2))
    position[:, 0], position[:, 1] = x, v
    motion = Trajectory(
        ("white", "red"), np.array(ball), np.array(start), np.array(end), position, np.zeros((5, 2, 3)),
        ("rest", "roll", "roll", "rest", "roll"), np.tile(1e-6 * np.eye(4), (5, 1, 1)),
    )  # fmt: skip
    listed_events = [("strike", 0.2, "white", "", 1.0), ("ball", TOUCH, "red", "white", 0.97)]
    listed_events += [] if cushion is None else [("cushion", cushion, "white", "top", 0.8)]
    listed_events.sort(key=lambda one: one[1])
    kinds, t, a, b, probability = (list(column) for column in zip(*listed_events, strict=True))
    one = np.ones(len(t))
    events = Events(
        tuple(kinds), np.array(t), 1e-3 * one, 30 * np.array(t), tuple(a), tuple(b), np.tile(place, (len(t), 1)),
        np.array(probability), -0.01 * one, 1e-3 * one, 1.0 * one,
    )  # fmt: skip
    fit = replace(shot.make_fit(T), trajectory=motion, events=events)
    xy = motion.at(T).xy
    ones = np.ones(xy.shape[:2])
    colour = np.array([[95.0, 0.0, 3.0], [45.0, 60.0, 40.0]])
    tracks = Tracks(
        np.arange(len(T)), T, ("white", "red"), ("white", "red"), xy, 100 * xy, 1e-3 * ones, 1e-3 * ones,
        np.zeros_like(xy), 3 * ones, colour,
    )  # fmt: skip
    return tracks, fit


def summarize(tracks: Tracks, fit: Fit, doubts: Sequence[str] = ()) -> list[ShotSummary]:
    return summarize_shots(tracks, fit, shot.make_scene().table, doubts)


def test_the_first_contact_has_its_time_speeds_and_probability() -> None:
    (summary,) = summarize(*make_shot((0.0, 0.5)))
    assert summary.first.startswith(
        "White hit red first. White was struck at 0.2000 s ± 1.0 ms and left at 1.00 m/s (3.6 km/h)"
    )
    assert summary.when.startswith("0.8000 s ± 1.0 ms (frame 24.0), 0.600 s after the stroke")
    assert "White arrived at 1.00 ± 0.01 m/s" in summary.speed
    assert "red left at 0.70 ± 0.01 m/s" in summary.speed
    assert summary.confidence.startswith("Red first: 97 %.")
    assert "Trust level of the clip: green." in summary.confidence


def test_a_break_is_told_with_its_spread_and_a_lost_ball_with_the_time_it_was_last_seen() -> None:
    tracks, fit = make_shot((0.4, 0.5))
    rack = RackBreak(0.0, 0.2, TOUCH, TOUCH + 0.1, "white", ("red",))
    hidden = np.where((T > 1.5)[:, None, None], np.nan, tracks.xy)
    fit = replace(fit, explanation=replace(fit.explanation, breaks=(rack,)), moving=np.ones((len(T), 2), bool))
    (summary,) = summarize(replace(tracks, xy=hidden), fit)
    assert summary.spread.startswith("White broke a cluster of 1 balls: 1 of them moved, 0 reached a rail and none")
    assert summary.spread.endswith("until 0.900 s is beyond what the film can show.")
    assert summary.ends[1].startswith("White: last seen at 1.500 s, moving at 0.64 m/s")


def test_a_call_that_is_less_sure_states_its_probability_but_drops_no_contact() -> None:
    tracks, fit = make_shot((0.0, 0.5))
    call = CallAnswer("first", ("white",), 0.4, TOUCH, met="red", alternatives=(("red", 0.4), ("unknown", 0.6)))
    (summary,) = summarize_shots(tracks, fit, shot.make_scene().table, calls=(call,))
    assert "red" in summary.first
    assert "40 %" in summary.confidence


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ((0.3, 0.05), "White went on 9° to the right of its own line, at 0.30 m/s (1.1 km/h)"),
        ((0.3, 0.001), "White went straight on, at 0.30 m/s (1.1 km/h)"),
        ((0.0, 0.5), "turned 90° to its own right, at 0.50 m/s (1.8 km/h)"),
        ((0.0, -0.5), "turned 90° to its own left, at 0.50 m/s (1.8 km/h)"),
        ((-0.4, 0.0), "came back, at 0.40 m/s (1.4 km/h)"),
        ((0.01, 0.0), "stopped at the place of contact"),
    ],
)
def test_the_turn_of_the_ball_is_described_as_seen_from_above(after: tuple[float, float], expected: str) -> None:
    """y runs down: a ball that goes along x and then along y has turned to its right."""
    (summary,) = summarize(*make_shot(after))
    assert expected in summary.after


def test_cushions_before_and_after_the_contact_are_mentioned_in_their_place() -> None:
    (before,) = summarize(*make_shot((0.0, 0.5), cushion=0.5))
    assert "White hit red first, after the far long rail." in before.first
    assert "It had no further contact" in before.after
    (after,) = summarize(*make_shot((0.0, 0.5), cushion=1.5))
    assert "Then it touched the far long rail at 1.5000 s ± 1.0 ms." in after.after
    assert "Of the other contacts, the least sure: white hits the far long rail (80 %)." in after.confidence
    tracks, fit = make_shot((0.0, 0.5))
    (struck,) = summarize(tracks, replace(fit, events=replace(fit.events, probability=np.array([0.98, 0.997]))))
    assert "Of the other contacts, the least sure: white is struck (98 %)." in struck.confidence


def test_a_ball_that_the_fit_holds_still_just_before_it_meets_a_cushion_did_not_stop() -> None:
    """Within the error of the cushion's time the motion is not known; the summary describes the motion before."""
    tracks, fit = make_shot((0.0, 0.5), cushion=1.1)
    motion, late = fit.trajectory, 1.09
    rows = [0, 1, 2, 0, 3, 4]  # a rest of white after its other pieces
    start, end = motion.start[rows], motion.end[rows]
    start[3], end[2], end[3] = late, late, 2.0
    still = Trajectory(
        motion.ids, motion.ball[rows], start, end, motion.position[rows], motion.spin[rows],
        tuple(motion.phase[k] for k in rows), motion.covariance[rows],
    )  # fmt: skip
    vague = replace(fit.events, t_sigma=np.array([1e-3, 1e-3, 0.02]))
    (summary,) = summarize(tracks, replace(fit, trajectory=still, events=vague))
    assert "turned 90° to its own right, at 0.50 m/s (1.8 km/h)" in summary.after
    assert "stopped" not in summary.after


def test_a_ball_that_is_observed_again_only_later_is_described_from_there() -> None:
    tracks, fit = make_shot((0.0, 0.5))
    motion = fit.trajectory
    again = replace(motion, start=np.where((motion.ball == 0) & (motion.start == TOUCH), 1.0, motion.start))
    (summary,) = summarize(tracks, replace(fit, trajectory=again))
    assert "White turned 90° to its own right, at 0.50 m/s (1.8 km/h) 0.40 s later." in summary.after


def test_the_first_later_contacts_are_listed_in_their_order() -> None:
    """A ball that is listed before cushions that were met earlier contradicts the score, which counts them."""
    tracks, fit = make_shot((0.0, 0.5))
    events = fit.events
    more = 9
    t = np.append(events.t, 1.0 + 0.1 * np.arange(more + 1))
    one = np.ones(len(t))
    many = Events(
        (*events.kind, *("cushion",) * more, "ball"), t, 1e-3 * one, 30 * t, ("white", "red", *("white",) * (more + 1)),
        ("", "white", *("top",) * more, "red"), np.zeros((len(t), 2)), one, -0.01 * one, 1e-3 * one, one,
    )  # fmt: skip
    (summary,) = summarize(tracks, replace(fit, events=many))
    assert "at 1.6000 s ± 1.0 ms and the far long rail at 1.7000 s ± 1.0 ms, then 2 more." in summary.after
    assert "All other contacts: above 99.9 %." in summary.confidence


@pytest.mark.parametrize("is_measurable", [True, False])
def test_speeds_are_those_of_the_table_of_numbers(is_measurable: bool) -> None:
    tracks, fit = make_shot((0.0, 0.5))
    numbers = (
        ShotNumber("contact_speed", 0.98, 0.02, "m/s", is_measurable, "white"),
        ShotNumber("object_speed", 0.69, 0.01, "m/s", False, "red"),
        ShotNumber("cut_angle", -31.0, 0.5, "deg", True, "red"),
    )
    listed = ShotNumbers(0.2, "white", "red", "stun", (0.02, 0.96, 0.02, 0.0), (), (), numbers)
    (summary,) = summarize(tracks, replace(fit, shot_numbers=(listed,)), () if is_measurable else ("A doubt.",))
    hit = "half ball (48 ± 1 % of the ball covered, cut angle 31.0 ± 0.5°), stun."
    assert summary.first.startswith(f"White hit red first: {hit}")
    assert summary.speed == ("White arrived at 0.98 ± 0.02 m/s (3.5 km/h)." if is_measurable else "Not measurable.")


def test_a_path_without_a_measurable_length_says_so_in_words() -> None:
    tracks, fit = make_shot((0.0, 0.5))
    way = [ShotNumber("length", 2.0, 0.1, "m", False, "white"), ShotNumber("cushions", 5.0, 0.0, "", True, "white")]
    listed = ShotNumbers(0.2, "white", "red", "unknown", (), (), (), tuple(way))
    (summary,) = summarize(tracks, replace(fit, shot_numbers=(listed,)))
    assert "; the length of its path is not measurable; it met 5 rails." in " ".join(summary.ends)


def test_a_doubt_about_the_scale_is_added_to_the_speeds() -> None:
    (summary,) = summarize(*make_shot((0.0, 0.5)), ("Every length may be 8 % smaller.",))
    assert summary.speed.endswith("red left at 0.70 ± 0.01 m/s (2.5 km/h). Every length may be 8 % smaller.")


def test_a_clip_that_ends_too_early_gives_the_last_speed_of_the_ball() -> None:
    (summary,) = summarize(*make_shot((0.0, 0.3)))
    assert summary.ends[:2] == (
        "White and red still move when the clip ends, at 2.000 s.",
        "White: still moving at 0.30 m/s (1.1 km/h), its centre 14.0 cm (0.6 diamonds) from the near long rail and"
        " 100.0 cm (4.0 diamonds) from the left short rail.",
    )


@pytest.mark.parametrize(("speed", "words"), [(0.02, "White: almost at rest, its"), (0.0, "White: at rest, its")])
def test_a_ball_that_still_creeps_when_the_clip_ends_is_almost_at_rest(speed: float, words: str) -> None:
    (summary,) = summarize(*make_shot((0.0, speed)))
    assert summary.ends[1].startswith(words)


def test_every_ball_has_its_end_and_its_way() -> None:
    """Red is potted, and white rests: nothing moves any more; a ball without events and motion did not move."""
    tracks, fit = make_shot((0.0, 0.3), cushion=1.5)
    ways = (
        ShotNumber("length", 1.2, 0.01, "m", True, "white"), ShotNumber("cushions", 2.0, 0.0, "", True, "white"),
    )  # fmt: skip
    events = replace(fit.events, kind=("strike", "pocket", "rest"), a=("white", "red", "white"), b=("", "top", ""))
    moving = np.zeros((len(T), 2), bool)
    played = replace(fit, events=events, moving=moving, shot_numbers=(ShotNumbers(0.2, "white", "red", "unknown", (),
                     (), (), ways),))  # fmt: skip
    (summary,) = summarize(tracks, played)
    assert summary.ends[0] == "No ball still moves when the clip ends, at 2.000 s."
    assert summary.ends[1].startswith("White: at rest since 1.5000 s ± 1.0 ms, its centre ")
    assert summary.ends[1].endswith("; it ran 1.20 ± 0.01 m and met 2 rails.")
    assert summary.ends[2] == "Red: fell into the far-side pocket at 0.8000 s ± 1.0 ms."
    strike = replace(fit.events, kind=("strike", "rest", "rest"), a=("white",) * 3, b=("",) * 3)
    (alone,) = summarize(tracks, replace(fit, events=strike, moving=moving))
    assert alone.ends[-1] == "Red did not move."


def test_a_second_meeting_is_called_so_and_a_carom_shot_says_whether_it_scored() -> None:
    tracks, fit = make_shot((0.0, 0.5), cushion=1.5)
    twice = replace(fit.events, kind=("strike", "ball", "ball"), b=("", "white", "red"))
    score = CallAnswer("score", ("white", "red", "yellow"), 0.0001, 1.5, margin=0.041, margin_sigma=0.001)
    (summary,) = summarize_shots(tracks, replace(fit, events=twice), shot.make_scene().table, calls=(score,))
    assert "Then it touched red again at 1.5000 s ± 1.0 ms." in summary.after
    assert name_event(twice, 2, fit.naming).endswith(" touch again")
    assert not name_event(twice, 1, fit.naming).endswith(" again")
    assert summary.score.startswith(
        "No point within the clip (above 99.9 %): white met no rails and missed red or yellow;"
    )
    assert "41.0 ± 1.0 mm from a touch" in summary.score
    assert format_score(score, fit.naming, is_moving=False).startswith("No point (above 99.9 %): "), "it lies still"


def test_unlikely_events_are_not_mentioned() -> None:
    tracks, fit = make_shot((0.0, 0.3))
    doubtful = replace(fit, events=replace(fit.events, probability=np.array([1.0, 0.2])))
    (summary,) = summarize(tracks, doubtful)
    assert summary.first.startswith("White touched no other ball. White was struck at")
    assert "no further contact" not in summary.after


def test_a_clip_that_begins_after_the_stroke_describes_the_moving_cue_ball() -> None:
    tracks, fit = make_shot((0.0, 0.3))
    events = fit.events
    late = Events(*(getattr(events, name)[1:] for name in ("kind", "t", "t_sigma", "frame", "a", "b", "xy",
                    "probability", "gap", "gap_sigma", "speed")))  # fmt: skip
    (summary,) = summarize(tracks, replace(fit, events=late))
    assert summary.first == "White hit red first. The clip shows no stroke; the motion before it is unknown."
    assert "after the stroke" not in summary.when


def test_the_summary_is_of_the_ball_that_the_calls_ask_about_and_names_an_undecided_stroke() -> None:
    tracks, fit = make_shot((0.0, 0.5))
    call = CallAnswer("first", ("red",), 0.97, TOUCH, met="white")
    unsure = replace(fit.events, probability=np.array([0.15, 0.97]), a=("red", "red"))
    fit = replace(fit, events=unsure)
    (summary,) = summarize_shots(tracks, fit, shot.make_scene().table, calls=(call,))
    assert summary.first == "Red hit white first. Red was perhaps struck at 0.2000 s ± 1.0 ms (15 %)."
    assert "the least sure: red is struck (15 %)" in summary.confidence


def test_a_ball_that_was_not_seen_before_its_contact_has_no_speed_there() -> None:
    tracks, fit = make_shot((0.0, 0.5))
    motion = fit.trajectory
    rows = [2, 3, 4]
    unseen = Trajectory(
        motion.ids, motion.ball[rows], motion.start[rows], motion.end[rows], motion.position[rows], motion.spin[rows],
        tuple(motion.phase[k] for k in rows), motion.covariance[rows],
    )  # fmt: skip
    events = fit.events
    late = Events(*(getattr(events, name)[1:] for name in ("kind", "t", "t_sigma", "frame", "a", "b", "xy",
                    "probability", "gap", "gap_sigma", "speed")))  # fmt: skip
    call = CallAnswer("first", ("white",), 0.97, TOUCH, met="red")
    fit = replace(fit, events=late, trajectory=unseen)
    (summary,) = summarize_shots(tracks, fit, shot.make_scene().table, calls=(call,))
    assert summary.first.startswith("White hit red first.")
    assert "The speed of white before the contact is not measurable" in summary.speed
    assert (
        "White moved at 0.50 m/s (1.8 km/h) 0.40 s later; its direction before the contact was not observed."
        in summary.after
    )


def test_where_nothing_moves_there_is_no_summary() -> None:
    tracks, fit = make_shot((0.0, 0.3))
    none = Events((), np.empty(0), np.empty(0), np.empty(0), (), (), np.empty((0, 2)), *(np.empty(0),) * 4)
    assert summarize(tracks, replace(fit, events=none, moving=np.zeros_like(tracks.is_observed))) == []


def test_every_potted_ball_is_mentioned() -> None:
    tracks, fit = make_shot((0.0, 0.5), cushion=1.5)
    events = fit.events
    fallen = replace(events, kind=("strike", "ball", "pocket"), a=("white", "red", "red"), b=("", "white", "top-right"))
    (summary,) = summarize(tracks, replace(fit, events=fallen))
    assert summary.potted == "Red into the far-right pocket at 1.5000 s ± 1.0 ms (80 %)."
    assert summarize(tracks, fit)[0].potted == ""
