"""Refinement of contact times: every ball contact is fitted again with exact physics.

The joint fit holds real tables with soft priors, which costs precision where a contact is observed well. Where the
contact laws of two balls explain the samples around a contact, they time it to the Cramer-Rao bound; elsewhere the time
of the joint fit stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.events import Events
from models.core.shot import ContactTestResult
from models.core.typing import FloatArray
from models.estimation.contact_test.candidate_contacts import cut_ball_window
from models.estimation.contact_test.contact_moment import PossibleContact
from models.estimation.contact_test.contact_time import estimate_contact_time
from models.estimation.contact_test.shot_record import ShotRecord

MAX_CHI2 = 1.6
"""Per degree of freedom: beyond, two ideal balls do not explain the samples."""
MAX_MOVE_SIGMAS = 4.0
"""Standard deviations of the joint fit that a time may move."""
MAX_MOVE = 4e-3
"""s: upper limit of that move."""
MIN_SAMPLES = 3
"""Least number of samples of a ball on either side of a contact."""


def refine_contact_times(record: ShotRecord) -> Events:
    """Refine the times of all ball contacts of a record where exact physics holds."""
    events = record.events
    t, t_sigma, gap, gap_sigma = (values.copy() for values in (events.t, events.t_sigma, events.gap, events.gap_sigma))
    for k in range(len(events)):
        result = _refine_contact_time(record, k) if events.kind[k] == "ball" else None
        if result is not None:
            excess = np.sqrt(max(result.chi2, 1.0))
            t[k], t_sigma[k] = result.t, result.t_sigma * excess
            gap[k], gap_sigma[k] = result.gap, result.gap_sigma * excess
    return _sort_events(record, replace(events, gap=gap, gap_sigma=gap_sigma), t, t_sigma)


def _refine_contact_time(record: ShotRecord, k: int) -> ContactTestResult | None:
    """Refine event k by exact physics; None where that does not hold."""
    events = record.events
    t, balls = float(events.t[k]), [record.ball_index(name) for name in (events.a[k], events.b[k])]
    try:
        windows = tuple(cut_ball_window(record, t, ball, {events.a[k], events.b[k]}) for ball in balls)
        if any(min(np.sum(ball.t < t), np.sum(ball.t > t)) < MIN_SAMPLES for ball in windows):
            return None
        result = estimate_contact_time(PossibleContact(windows, 2 * record.table.ball_radius, record.reach_sigma), t)
    except (ValueError, np.linalg.LinAlgError):
        return None
    shift = abs(result.t - t)
    is_near = shift < min(MAX_MOVE_SIGMAS * float(events.t_sigma[k]), MAX_MOVE)
    return result if result.closing > 0 and result.chi2 < MAX_CHI2 and is_near else None


def _sort_events(record: ShotRecord, events: Events, t: FloatArray, t_sigma: FloatArray) -> Events:
    """Sort events by their new times t (E,)."""
    order = np.argsort(t, kind="stable")
    frame = np.array([record.frame_at(moment) for moment in t]).reshape(-1)
    has_moved = t != events.t
    return Events(
        tuple(events.kind[k] for k in order), t[order], t_sigma[order], np.where(has_moved, frame, events.frame)[order],
        tuple(events.a[k] for k in order), tuple(events.b[k] for k in order), events.xy[order],
        events.probability[order], events.gap[order], events.gap_sigma[order], events.speed[order],
    )  # fmt: skip
