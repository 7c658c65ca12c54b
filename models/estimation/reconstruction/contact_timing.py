"""When balls touched, to what the samples can tell at best: every contact looked at again with exact physics.

The joint fit of a clip holds real tables with soft knowledge, which costs precision where a contact is seen well. Where
the laws of two balls explain the samples around a contact, they time it to the Cramer-Rao bound; elsewhere the joint
fit stands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.events import Events
from models.core.typing import FloatArray
from models.estimation.contact_test.candidate_contacts import watched
from models.estimation.contact_test.contact_moment import Encounter
from models.estimation.contact_test.contact_probability import Verdict, timed
from models.estimation.contact_test.shot_record import Record

WORST_CHI2 = 1.6
"""per degree of freedom: beyond, two ideal balls do not explain what was seen."""
FARTHEST = 4.0
"""standard deviations of the joint fit that a time may move."""
LONGEST = 4e-3
"""s: nor farther than this."""
ENOUGH = 3
"""Samples of a moving ball on either side of a contact, at least."""


def retimed(record: Record) -> Events:
    """The events of a record, contacts of two balls timed anew where exact physics holds."""
    events = record.events
    t, t_sigma, gap, gap_sigma = (values.copy() for values in (events.t, events.t_sigma, events.gap, events.gap_sigma))
    for k in range(len(events)):
        found = _again(record, k) if events.kind[k] == "ball" else None
        if found is not None:
            excess = np.sqrt(max(found.chi2, 1.0))
            t[k], t_sigma[k] = found.t, found.t_sigma * excess
            gap[k], gap_sigma[k] = found.gap, found.gap_sigma * excess
    return _sorted(record, replace(events, gap=gap, gap_sigma=gap_sigma), t, t_sigma)


def _again(record: Record, k: int) -> Verdict | None:
    """Event k as exact physics sees it; None where that does not hold."""
    events = record.events
    t, balls = float(events.t[k]), [record.number(name) for name in (events.a[k], events.b[k])]
    try:
        seen = tuple(watched(record, t, ball, {events.a[k], events.b[k]}) for ball in balls)
        if any(min(np.sum(ball.t < t), np.sum(ball.t > t)) < ENOUGH for ball in seen):
            return None
        found = timed(Encounter(seen, 2 * record.table.ball_radius, record.reach_sigma), t)
    except (ValueError, np.linalg.LinAlgError):
        return None
    moved = abs(found.t - t)
    near = moved < min(FARTHEST * float(events.t_sigma[k]), LONGEST)
    return found if found.closing > 0 and found.chi2 < WORST_CHI2 and near else None


def _sorted(record: Record, events: Events, t: FloatArray, t_sigma: FloatArray) -> Events:
    """Events in the order of new times t (E,)."""
    order = np.argsort(t, kind="stable")
    frame = np.array([record.frame_at(moment) for moment in t]).reshape(-1)
    moved = t != events.t
    return Events(
        tuple(events.kind[k] for k in order), t[order], t_sigma[order], np.where(moved, frame, events.frame)[order],
        tuple(events.a[k] for k in order), tuple(events.b[k] for k in order), events.xy[order],
        events.probability[order], events.gap[order], events.gap_sigma[order], events.speed[order],
    )  # fmt: skip
