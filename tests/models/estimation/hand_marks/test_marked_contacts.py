"""Contacts set by hand are strong priors: the fit takes them over, and says where the motion contradicts."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support import filmed_shots

from models.core.corrections import BallPlace, ContactCorrection, Corrections
from models.core.fit_result import Fit
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

SHOT = filmed_shots.film(
    np.array([[0.5, 0.6], [1.1, 0.62], [1.2, 0.3]]), np.array([[2.6, 0.0], [0, 0], [0, 0]]), np.zeros((3, 3)),
    np.random.default_rng(4), seconds=2.6,
)  # fmt: skip
"""The cue ball meets `solid-1`, which hits the right cushion; `solid-2` rests apart."""
FPS = 30


@cache
def fit(*marks: ContactCorrection) -> Fit:
    return view_shot(explain(SHOT.tracks, SHOT.scene, corrections=Corrections(contacts=marks)))


def place(ball: str, frame: float) -> BallPlace:
    row = round(frame)
    x, y = SHOT.xy[row, SHOT.tracks.ids.index(ball)] * filmed_shots.PX_PER_M + 50
    return BallPlace(row, float(x), float(y), ball)


def find(result: Fit, kind: str, *balls: str) -> list[int]:
    events = result.events
    return [k for k in range(len(events)) if events.kind[k] == kind and {events.a[k], events.b[k]} - {""} == set(balls)]


def frame_of(kind: str, *balls: str) -> float:
    plain = fit()
    return float(plain.events.frame[find(plain, kind, *balls)[0]])


def test_the_shot_has_its_contacts_without_marks() -> None:
    assert find(fit(), "ball", "cue", "solid-1")
    assert find(fit(), "cushion", "solid-1", "right")
    assert fit().mark_outcomes == ()


def test_a_mark_of_a_contact_that_the_fit_has_confirms_it_and_moves_nothing() -> None:
    at = frame_of("ball", "cue", "solid-1")
    marked = fit(ContactCorrection("mark", "ball", round(at), place("cue", at), place("solid-1", at)))
    (outcome,) = marked.mark_outcomes
    assert (outcome.code, outcome.balls) == ("confirmed", ("cue", "solid-1"))
    assert outcome.value > 100
    assert marked.events.kind == fit().events.kind
    assert marked.events.t == pytest.approx(fit().events.t, abs=1e-3)
    assert marked.events.probability[find(marked, "ball", "cue", "solid-1")[0]] > 0.999


def test_a_deleted_contact_leaves_the_events_and_the_motion_contradicts() -> None:
    at = frame_of("ball", "cue", "solid-1")
    marked = fit(ContactCorrection("delete", "ball", at, place("cue", at), place("solid-1", at)))
    (outcome,) = marked.mark_outcomes
    assert outcome.code == "change_remains"
    assert outcome.value > 1000
    assert not find(marked, "ball", "cue", "solid-1")
    causes = {(one.ball, one.best.cause) for one in marked.explanation.moments if abs(one.t - at / FPS) < 0.05}
    assert ("solid-1", "unexplained") in causes


def test_a_strike_that_no_motion_shows_is_listed_and_contradicted() -> None:
    marked = fit(ContactCorrection("mark", "strike", 40.0, place("solid-2", 40)))
    (outcome,) = marked.mark_outcomes
    assert outcome.code == "no_change"
    assert not outcome.value > 20
    (event,) = find(marked, "strike", "solid-2")
    assert marked.events.frame[event] == pytest.approx(40, abs=1.5)


def test_bodies_that_are_far_apart_do_not_touch_though_a_mark_says_so() -> None:
    marked = fit(ContactCorrection("mark", "ball", 30.0, place("cue", 30), place("solid-2", 30)))
    (outcome,) = marked.mark_outcomes
    assert outcome.code == "too_far"
    row = 30
    apart = np.hypot(*(SHOT.xy[row, 0] - SHOT.xy[row, 2])) - 2 * filmed_shots.RADIUS
    assert outcome.value == pytest.approx(apart, abs=0.02)
    assert marked.events.kind == fit().events.kind


def test_a_contact_that_was_moved_far_from_its_motion_is_put_back_and_that_is_said() -> None:
    at = frame_of("cushion", "solid-1", "right")
    move = ContactCorrection(
        "move", "cushion", at, place("solid-1", at), cushion="right", to_frame=at + 1.9
    )  # fmt: skip
    marked = fit(move)
    (outcome,) = marked.mark_outcomes
    assert outcome.code == "other_time"
    assert outcome.value == pytest.approx(-1.9 / FPS, abs=0.01)
    assert marked.events.frame[find(marked, "cushion", "solid-1", "right")[0]] == pytest.approx(at, abs=0.1)


def test_a_mark_of_a_ball_that_is_not_tracked_changes_nothing() -> None:
    marked = fit(ContactCorrection("mark", "strike", 20.0, BallPlace(20, 5.0, 5.0, "ghost")))
    (outcome,) = marked.mark_outcomes
    assert (outcome.code, outcome.balls) == ("ball_missing", ("ghost",))
    assert np.array_equal(marked.events.t, fit().events.t)
