"""Contacts that no hypothesis lists: how probable they are, learned on shots of another engine.

Where every motion of two balls has a cause, hardly any contact is missed. Where one of them turned for an unknown
cause, or moved when it was first detected, either may have touched more than is listed.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.shot_hypotheses.event_probability import read_event_model

PairClass = Literal["clear", "unclear_far", "unclear_near"]
UNCLEAR_PROBABILITY = 0.05
"""Probability of an unexplained change from which the motion of a ball is unclear."""
NEAR_RADII = 8.0
"""Ball radii between two surfaces within which an unlisted contact is likelier: what a ball at 5 m/s goes in two
frames at 30 fps."""


def list_unclear_times(record: ShotRecord, ball: int) -> list[float]:
    """List when a ball moved for an unknown reason: unexplained changes, breaks, and its first detection if it moved.

    Args:
        record: The shot.
        ball: Index of the ball.

    Returns:
        Times, s.
    """
    name, explanation = record.ids[ball], record.explanation
    times = [
        moment.t
        for moment in explanation.moments
        if moment.ball == name and moment.best.cause != "strike"
        for one in moment.hypotheses
        if one.cause == "unexplained" and one.probability >= UNCLEAR_PROBABILITY
    ]
    times += [one.end for one in explanation.breaks if name in one.rack and one.end > one.t]
    own = record.t[record.ball == ball]
    return times + ([float(own[0])] if name in explanation.moving_at_start and len(own) else [])


def classify_pair(record: ShotRecord, one: int, two: int) -> PairClass:
    """Classify two balls by how an unlisted contact could have been missed.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        `clear` where the motion of both is explained, `unclear_near` where they were near each other when that of one
        was not, else `unclear_far`.
    """
    times = list_unclear_times(record, one) + list_unclear_times(record, two)
    if not times:
        return "clear"
    return "unclear_near" if any(is_pair_near(record, one, two, t) for t in times) else "unclear_far"


def is_pair_near(record: ShotRecord, one: int, two: int, t: float) -> bool:
    """Return whether two balls were so near at a time that a contact may have been missed.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.
        t: s.

    Returns:
        Whether their surfaces were within `NEAR_RADII`, or their distance is not known.
    """
    distance = float(np.hypot(*(record.position_at(two, t) - record.position_at(one, t))))
    return not distance > (2 + NEAR_RADII) * record.table.ball_radius


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
