"""Moments of a recorded shot: close passes that are tested again, motion without a cause, and doubts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import staged_shot as shot

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, JointSolution, Segment, layout_parameters
from models.core.fit_result import CauseHypothesis, Moment, ShotExplanation
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.shot_record import make_shot_record
from models.estimation.reconstruction import event_list
from models.estimation.reconstruction.shot_views import _warn_of_unexplained_changes
from models.estimation.reconstruction.unexplained_motion import mark_unexplained_motion


@pytest.mark.parametrize(("deceleration", "is_explained"), [(3.0, True), (4.0, False)])
def test_a_ball_that_brakes_harder_than_cloth_can_is_unexplained(deceleration: float, is_explained: bool) -> None:
    """Sliding on the roughest cloth brakes by 3 m/s^2; a finger on the ball brakes harder."""
    times = np.arange(11) / 10
    position = np.zeros((3, 4, 2))
    position[:, 0], position[:2, 1] = shot.place(0.0)[[0, 0, 1]], [4.0, 0.0]
    position[1, 0] += [0.4 * 4.0, 0.0]
    position[1, 2] = [-deceleration / 2, 0.0]
    calm = shot.trajectory(1.0)
    braked = replace(calm, start=np.array([0.0, 0.4, 0.0]), end=np.array([0.4, 1.0, 1.0]), position=position)
    moments = mark_unexplained_motion(ShotExplanation(), braked, shot.tracks(times)).moments
    assert (len(moments) == 0) == is_explained
    assert all(one.ball == "cue" and 0.3 < one.t < 1.0 for one in moments)


def test_a_change_without_a_cause_is_named_once_though_two_hypotheses_have_it() -> None:
    """A ball that bends, and whose path jumps at the same time, did so once."""
    cause = (CauseHypothesis("unexplained", "", 0.8), CauseHypothesis("cushion", "left", 0.2))
    moments = tuple(Moment("cue", t, 1e-2, np.zeros(2), cause) for t in (0.5, 0.5, 0.7))
    fit = shot.fit(np.arange(31) / shot.RATE)
    assert _warn_of_unexplained_changes(ShotExplanation(moments), fit.naming) == (
        f"Changed speed or direction without a known cause: {fit.naming.say('cue')} at 0.500 s ± 10 ms,"
        f" {fit.naming.say('cue')} at 0.700 s ± 10 ms.",
    )


@pytest.mark.parametrize(("away", "concerns"), [(0.12, True), (0.18, False)])
def test_a_doubt_concerns_what_happens_within_a_few_frames(away: float, concerns: bool) -> None:
    """Four to five frames at 30 fps: the samples from which a velocity is measured."""
    times = np.arange(31) / shot.RATE
    fit, scene = shot.fit(times), shot.scene()
    hidden = Moment("cue", 0.5, 1e-3, np.zeros(2), (CauseHypothesis("none", "", 1.0),), ("hidden",))
    record = make_shot_record(
        shot.tracks(times), fit.events, fit.trajectory, scene.table, scene.camera, ShotExplanation((hidden,))
    )
    doubts = call_answers.list_doubts(record, 0.5 + away, ("cue", "red"), True)["doubts"]
    assert ("hidden" in doubts) == concerns


@pytest.mark.parametrize(("sigma", "count"), [(0.42, 1), (0.58, 0)])
def test_a_ball_that_stopped_some_time_within_a_second_has_no_moment_of_rest(sigma: float, count: int) -> None:
    contact = Contact("ball", 0.5, (0,), (1,))
    state = np.array([0.5, 0.4, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    graph = ContactGraph((Segment(0, False, None, 0, 0.0, state), Segment(0, True, 0, None, 0.5, state)), (contact,))
    layout = layout_parameters(graph)
    covariance = sigma**2 * np.eye(layout.size)
    solution = JointSolution(graph, ClothFriction(0.2, 0.01), 1.0, np.zeros(4), np.zeros(3), 0.0, covariance)
    assert len(event_list._list_stopped_balls(solution, layout, 0, contact, ("cue",))) == count
