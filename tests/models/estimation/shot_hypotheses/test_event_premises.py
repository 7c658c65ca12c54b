"""Premises of events: what the trust level knows enters every event, contact and call."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from models.core.contact_graph import Contact, ContactGraph, Segment
from models.core.fit_result import MIN_LISTED_PROBABILITY, SURE_PROBABILITY, BallPremise, ShotExplanation
from models.core.shot import ContactTestResult
from models.estimation.reconstruction import shot_views
from models.estimation.shot_hypotheses.event_probability import (
    PREMISE_EVIDENCE_NAMES,
    EventEvidence,
    EventRow,
    PremiseEvidence,
    assess_premises,
    estimate_event_probability,
    estimate_premise_probability,
    read_event_model,
    weigh_close_pass,
)
from models.estimation.shot_hypotheses.weigh_hypotheses import _weigh_premises

RADIUS = 0.03


def test_no_evidence_makes_premises_more_probable() -> None:
    model = read_event_model()
    assert set(model.premise_weight) == set(PREMISE_EVIDENCE_NAMES)
    assert min(model.premise_weight.values()) >= 0
    assert estimate_premise_probability(PremiseEvidence()) > SURE_PROBABILITY


def test_no_event_is_sure_of_a_ball_whose_motion_is_hardly_explained() -> None:
    """An object that no accepted fit explains for 88 % of its time starts twice and turns beside a ball that rolls."""
    hand, ball = assess_premises(*np.array([[1.0, 2.0], [0.12, 2.0], [4.0, 0.0], [2.0, 0.0], [0.0, 0.0]]))
    assert hand.probability < MIN_LISTED_PROBABILITY
    assert SURE_PROBABILITY > 0.8 > hand.probability
    assert ball.probability > 0.8
    assert ball.evidence == pytest.approx((0.0, 0.88, 0.0, 0.0, 0.0))


def test_balls_that_never_move_have_nothing_against_them() -> None:
    (still,) = assess_premises(*np.zeros((5, 1)))
    assert not any(still.evidence)


def test_no_rest_is_likely_of_what_starts_by_itself_and_is_there_for_half_of_the_clip() -> None:
    """A net in a pocket sways: it is found in half of the frames only, and nothing sets it in motion."""
    rest = estimate_event_probability("rest", EventEvidence())
    net, ball = assess_premises(*np.array([[1.0, 1.0], [1.0, 1.0], [0.0, 0.0], [1.0, 0.0], [0.5, 0.05]]))
    assert rest * net.probability < 0.9 < rest * ball.probability


def test_an_event_is_as_probable_as_its_weakest_premise_allows() -> None:
    premises = {"cue": BallPremise(0.99), "hand": BallPremise(0.2)}
    rows = [
        EventRow("ball", 0.5, 1e-3, a, b, np.zeros(2), "ball", probability=0.9)
        for a, b in (("cue", "hand"), ("cue", "red"), ("red", "left"))
    ]
    weighed = _weigh_premises(premises, [(row, EventEvidence()) for row in rows])
    assert [row.probability for row, _ in weighed] == pytest.approx([0.18, 0.891, 0.9])


def test_a_close_pass_rests_on_the_same_premises() -> None:
    result = ContactTestResult(1.0, 0.5, 1e-3, -1e-3, 1e-4, 1.0, 0.0, 0.5)
    (_, certain), (_, doubted) = (weigh_close_pass("red", result, premise) for premise in (1.0, 0.5))
    assert doubted == pytest.approx(certain / 2)
    assert ShotExplanation(premises={"red": BallPremise(0.5)}).premise_probability("cue", "red") == 0.5


@pytest.mark.parametrize(
    ("way", "after", "size"),
    [
        ((0.2, 0.0), (1.0, 0.0), 0.0),  # five frames are missing
        ((-0.2, 0.0), (1.0, 0.0), 1.0),  # another object
        ((0.2, 0.015), (1.0, 0.0), 0.5),
        ((0.0, 0.0), (0.9, 0.0), 0.1),
        ((0.0, 0.0), (-1.0, 0.0), 2.0),
    ],
)
def test_changes_count_by_their_size_and_missing_frames_not_at_all(
    monkeypatch: pytest.MonkeyPatch, way: tuple[float, float], after: tuple[float, float], size: float
) -> None:
    states = [np.array([0.5, 0.5, 1.0, 0.0, 0, 0, 0, 0]), np.array([0.5 + way[0], 0.5 + way[1], *after, 0, 0, 0, 0])]
    segments = (Segment(0, False, None, 0, 0.0, states[0]), Segment(0, False, 0, None, 0.5, states[1]))
    graph = ContactGraph(segments, (Contact("jump", 0.5, (0,), (1,)),))
    monkeypatch.setattr(shot_views, "end_state", lambda _, k: states[k])
    solution = SimpleNamespace(graph=graph)
    changes = shot_views._sum_causeless_changes(solution, set(), RADIUS, ("cue", "red"))  # type: ignore[arg-type]
    np.testing.assert_allclose(changes, [size, 0.0], atol=1e-9)
    assert not shot_views._sum_causeless_changes(solution, {0}, RADIUS, ("cue",)).any()  # type: ignore[arg-type]
