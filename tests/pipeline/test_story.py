"""The five answers of a shot: who, when, how fast, what then, how sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from pipeline.reporting.text.shot_summary import tell

T = np.linspace(0, 2, 61)
TOUCH = 0.8


def played(after: tuple[float, float], cushion: float | None = None) -> tuple[Tracks, Fit]:
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
    told = [("strike", 0.2, "white", "", 1.0), ("ball", TOUCH, "red", "white", 0.97)]
    told += [] if cushion is None else [("cushion", cushion, "white", "top", 0.8)]
    told.sort(key=lambda one: one[1])
    kinds, t, a, b, probability = (list(column) for column in zip(*told, strict=True))
    one = np.ones(len(t))
    events = Events(
        tuple(kinds), np.array(t), 1e-3 * one, 30 * np.array(t), tuple(a), tuple(b), np.tile(place, (len(t), 1)),
        np.array(probability), -0.01 * one, 1e-3 * one, 1.0 * one,
    )  # fmt: skip
    fit = replace(shot.made_up_fit(T), trajectory=motion, events=events)
    xy = motion.at(T).xy
    ones = np.ones(xy.shape[:2])
    colour = np.array([[95.0, 0.0, 3.0], [45.0, 60.0, 40.0]])
    tracks = Tracks(
        np.arange(len(T)), T, ("white", "red"), ("white", "red"), xy, 100 * xy, 1e-3 * ones, 1e-3 * ones,
        np.zeros_like(xy), 3 * ones, colour,
    )  # fmt: skip
    return tracks, fit


def test_the_first_contact_is_told_with_its_time_speeds_and_probability() -> None:
    (story,) = tell(*played((0.0, 0.5)))
    assert story.first.startswith("white hit red first. It was struck at 0.2000 s ± 1.0 ms and left at 1.00 m/s")
    assert story.when.startswith("0.8000 s ± 1.0 ms (picture 24.00), 0.600 s after the stroke")
    assert "closed at 1.00 m/s" in story.speed
    assert "white came at 1.00 ± 0.00" in story.speed
    assert "red left at 0.70 m/s" in story.speed
    assert story.sure.startswith("The first contact is 97.0 % sure")
    assert "trust light is green" in story.sure


@pytest.mark.parametrize(
    ("after", "told"),
    [
        ((0.3, 0.05), "went on in its old direction (9° to the right), at 0.30 m/s"),
        ((0.0, 0.5), "went off 90° to the right of its old way, at 0.50 m/s"),
        ((0.0, -0.5), "went off 90° to the left of its old way, at 0.50 m/s"),
        ((-0.4, 0.0), "came back, at 0.40 m/s"),
        ((0.01, 0.0), "stopped where it was"),
    ],
)
def test_what_the_ball_did_then_is_said_as_seen_from_above(after: tuple[float, float], told: str) -> None:
    """y runs down: a ball that goes along x and then along y has turned to its right."""
    (story,) = tell(*played(after))
    assert told in story.after


def test_cushions_before_and_after_the_contact_are_told_in_their_place() -> None:
    (before,) = tell(*played((0.0, 0.5), cushion=0.5))
    assert "white hit red first, by way of the top cushion." in before.first
    assert "It met nothing more" in before.after
    (after,) = tell(*played((0.0, 0.5), cushion=1.5))
    assert "Then it met the top cushion at 1.500 s." in after.after
    assert "the least sure is 80.0 % sure (white hits the top cushion at 1.00 m/s)" in after.sure


def test_a_ball_that_the_fit_holds_still_just_before_it_meets_a_cushion_did_not_stop() -> None:
    """Within the error of the cushion's time the motion is not known; what is told is how the ball went before."""
    tracks, fit = played((0.0, 0.5), cushion=1.1)
    motion, late = fit.trajectory, 1.09
    rows = [0, 1, 2, 0, 3, 4]  # a rest of white after its other pieces
    start, end = motion.start[rows], motion.end[rows]
    start[3], end[2], end[3] = late, late, 2.0
    still = Trajectory(
        motion.ids, motion.ball[rows], start, end, motion.position[rows], motion.spin[rows],
        tuple(motion.phase[k] for k in rows), motion.covariance[rows],
    )  # fmt: skip
    vague = replace(fit.events, t_sigma=np.array([1e-3, 1e-3, 0.02]))
    (story,) = tell(tracks, replace(fit, trajectory=still, events=vague))
    assert "went off 90° to the right of its old way, at 0.50 m/s" in story.after
    assert "stopped" not in story.after


def test_a_ball_that_is_seen_again_only_a_while_after_the_contact_is_told_from_there() -> None:
    tracks, fit = played((0.0, 0.5))
    motion = fit.trajectory
    again = replace(motion, start=np.where((motion.ball == 0) & (motion.start == TOUCH), 1.0, motion.start))
    (story,) = tell(tracks, replace(fit, trajectory=again))
    assert "white went off 90° to the right of its old way, at 0.50 m/s 0.40 s later." in story.after


def test_balls_that_were_met_are_told_before_cushions() -> None:
    tracks, fit = played((0.0, 0.5))
    events = fit.events
    more = 7
    t = np.append(events.t, 1.0 + 0.1 * np.arange(more + 1))
    one = np.ones(len(t))
    many = Events(
        (*events.kind, *("cushion",) * more, "ball"), t, 1e-3 * one, 30 * t, ("white", "red", *("white",) * (more + 1)),
        ("", "white", *("top",) * more, "red"), np.zeros((len(t), 2)), one, -0.01 * one, 1e-3 * one, one,
    )  # fmt: skip
    (story,) = tell(tracks, replace(fit, events=many))
    assert "the top cushion at 1.400 s and red at 1.700 s and 2 more." in story.after
    assert "all that this ball met besides is at least 99.9 % sure" in story.sure


def test_a_doubt_about_the_scale_stands_beside_the_speeds() -> None:
    (story,) = tell(*played((0.0, 0.5)), ("Every length may be 8 % smaller.",))
    assert story.speed.endswith("red left at 0.70 m/s. Every length may be 8 % smaller.")


def test_a_clip_that_ends_too_early_says_how_fast_the_ball_still_is() -> None:
    (story,) = tell(*played((0.0, 0.3)))
    assert "When the clip ends, at 2.00 s, it still rolls at 0.30 m/s, at (1.000, 0.860) m." in story.after


def test_what_is_not_likely_is_not_told() -> None:
    tracks, fit = played((0.0, 0.3))
    doubtful = replace(fit, events=replace(fit.events, probability=np.array([1.0, 0.2])))
    (story,) = tell(tracks, doubtful)
    assert story.first.startswith("white touched no other ball.")


def test_a_clip_that_begins_after_the_stroke_tells_of_the_cue_ball_that_moves() -> None:
    tracks, fit = played((0.0, 0.3))
    events = fit.events
    late = Events(*(getattr(events, name)[1:] for name in ("kind", "t", "t_sigma", "frame", "a", "b", "xy",
                    "probability", "gap", "gap_sigma", "speed")))  # fmt: skip
    (story,) = tell(tracks, replace(fit, events=late))
    assert story.first == "white hit red first. No stroke is seen in this clip: what came before it is not told."
    assert "after the stroke" not in story.when


def test_of_two_that_meet_the_one_that_was_not_seen_before_is_the_one_that_came() -> None:
    tracks, fit = played((0.0, 0.5))
    motion = fit.trajectory
    kept = [2, 3, 4]
    unseen = Trajectory(
        motion.ids, motion.ball[kept], motion.start[kept], motion.end[kept], motion.position[kept], motion.spin[kept],
        tuple(motion.phase[k] for k in kept), motion.covariance[kept],
    )  # fmt: skip
    events = fit.events
    late = Events(*(getattr(events, name)[1:] for name in ("kind", "t", "t_sigma", "frame", "a", "b", "xy",
                    "probability", "gap", "gap_sigma", "speed")))  # fmt: skip
    (story,) = tell(tracks, replace(fit, events=late, trajectory=unseen))
    assert story.first.startswith("white hit red first.")
    assert "how fast white came was not seen" in story.speed
    assert "white went at 0.50 m/s 0.40 s later; from where it came was not seen." in story.after


def test_where_nothing_moves_there_is_no_story() -> None:
    tracks, fit = played((0.0, 0.3))
    none = Events((), np.empty(0), np.empty(0), np.empty(0), (), (), np.empty((0, 2)), *(np.empty(0),) * 4)
    assert tell(tracks, replace(fit, events=none, moving=np.zeros_like(tracks.observed))) == []


def test_what_falls_is_told_of_every_ball() -> None:
    tracks, fit = played((0.0, 0.5), cushion=1.5)
    events = fit.events
    fallen = replace(events, kind=("strike", "ball", "pocket"), a=("white", "red", "red"), b=("", "white", "top-right"))
    (story,) = tell(tracks, replace(fit, events=fallen))
    assert story.potted == "red into the top-right pocket at 1.5000 s ± 1.0 ms."
    assert tell(tracks, fit)[0].potted == ""
