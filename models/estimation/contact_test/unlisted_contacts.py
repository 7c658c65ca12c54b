"""Contacts that no hypothesis lists: how probable they are, learned on shots of another engine.

Where every motion of two balls has a cause, hardly any contact is missed. Where one of them turned for an unknown
cause, or moved when it was first detected, either may have touched more than is listed.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from models.core.shot_explanation import ShotExplanation
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.shot_hypotheses.event_probability import read_event_model

PairClass = Literal["clear", "unclear_far", "unclear_near"]
UNCLEAR_PROBABILITY = 0.05
"""Probability of an unexplained change from which the motion of a ball is unclear."""
NEAR_RADII = 8.0
"""Ball radii between two surfaces within which an unlisted contact is likelier: what a ball at 5 m/s goes in two
frames at 30 fps."""


def is_motion_unclear(explanation: ShotExplanation, ball: str) -> bool:
    """Return whether a ball moved when it was first detected, or changed its velocity for an unknown cause.

    Args:
        explanation: Explanation of the shot.
        ball: Id of the ball.

    Returns:
        Whether it may have touched more than is listed.
    """
    return ball in explanation.moving_at_start or any(
        hypothesis.cause == "unexplained" and hypothesis.probability >= UNCLEAR_PROBABILITY
        for moment in explanation.moments
        if moment.ball == ball and moment.best.cause != "strike"
        for hypothesis in moment.hypotheses
    )


def classify_pair(record: ShotRecord, one: int, two: int) -> PairClass:
    """Classify two balls by how an unlisted contact could have been missed.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        The class.
    """
    if not any(is_motion_unclear(record.explanation, record.ids[k]) for k in (one, two)):
        return "clear"
    distance = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    is_near = not np.isfinite(distance).any() or float(np.nanmin(distance)) < NEAR_RADII * record.table.ball_radius
    return "unclear_near" if is_near else "unclear_far"


def probability_of_unlisted_contact(record: ShotRecord, one: int, two: int) -> float:
    """Return the probability of a contact of two balls that no hypothesis lists.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        The learned share of such pairs that touched.
    """
    return read_event_model().unlisted_contact[classify_pair(record, one, two)]


def probability_of_unlisted_event() -> float:
    """Return the probability of an event that no hypothesis lists, where every motion has a cause.

    Returns:
        The learned share of pairs of balls with clear motion that touched without a listed contact.
    """
    return read_event_model().unlisted_contact["clear"]
