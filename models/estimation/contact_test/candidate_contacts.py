"""Candidate contacts of balls and cushions in a recorded shot, each with its probability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS
from models.estimation.contact_test.contact_moment import BallWindow, CushionLine, PossibleContact, make_ball_window
from models.estimation.contact_test.contact_probability import evaluate_contact
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.segmentation.contact_classification import INWARD_NORMALS, cushion_distances

WINDOW_TIME = 0.4
"""s to either side of a moment: farther away, deviations of a table from the laws of rolling exceed the noise."""
GUARD_SIGMAS = 3.0
"""Standard deviations of its time that samples keep from another event."""
NEAR_PASS_RADII = 0.25
"""Ball radii: paths that pass each other within it may have met."""
SAME_MOMENT_TIME = 0.06
"""s: an event and a near pass so close in time are one moment."""
REST_SPEED = 0.02
"""m/s below which a ball looks at rest."""
MIN_PROBABILITY, MAX_PROBABILITY = 0.001, 0.999
"""Limits of all probabilities: the images may not show what happened."""


@dataclass(frozen=True, slots=True)
class CandidateContact:
    """A contact that may have happened."""

    ball: int
    other: str
    """The other ball or the cushion."""
    t: float
    t_sigma: float
    probability: float
    gap: float
    gap_sigma: float


def find_ball_candidates(record: ShotRecord, one: int, two: int) -> list[CandidateContact]:
    """Find and evaluate every moment at which two balls may have touched."""
    candidates = []
    for t in _candidate_times(record, one, two):
        parties = {record.ids[one], record.ids[two]}
        try:
            balls = tuple(cut_ball_window(record, t, ball, parties) for ball in (one, two))
            question = PossibleContact(balls, 2 * record.table.ball_radius, record.reach_sigma)
            candidates.append(_evaluate_candidate(question, one, record.ids[two], t))
        except ValueError:  # too few samples for a test: use the event of the run
            candidates.append(_candidate_from_events(record, one, two, t))
    return candidates


def find_cushion_candidates(record: ShotRecord, one: int) -> list[CandidateContact]:
    """Find and evaluate every moment at which a ball met a cushion."""
    events, candidates = record.events, []
    for e in range(len(events)):
        if events.kind[e] != "cushion" or events.a[e] != record.ids[one]:
            continue
        side, t = CUSHIONS.index(events.b[e]), float(events.t[e])
        inward = INWARD_NORMALS[side]
        nose = -float(cushion_distances(np.zeros(2), record.table)[side]) + record.table.ball_radius
        from_event = CandidateContact(one, events.b[e], t, float(events.t_sigma[e]), float(events.probability[e]),
                      float(events.gap[e]), float(events.gap_sigma[e]))  # fmt: skip
        try:
            balls = (cut_ball_window(record, t, one, {record.ids[one], events.b[e]}),)
            question = PossibleContact(balls, record.table.ball_radius, record.nose_sigma, CushionLine(inward, nose))
            candidates.append(_evaluate_candidate(question, one, events.b[e], t))
        except ValueError:
            candidates.append(from_event)
    return candidates


def _evaluate_candidate(question: PossibleContact, one: int, other: str, t: float) -> CandidateContact:
    result = evaluate_contact(question, t)
    probability = float(np.clip(result.probability, MIN_PROBABILITY, MAX_PROBABILITY))
    return CandidateContact(one, other, result.t, result.t_sigma, probability, result.gap, result.gap_sigma)


def _candidate_from_events(record: ShotRecord, one: int, two: int, t: float) -> CandidateContact:
    """Make a candidate from the events of the run, or else from the fitted paths alone."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    for e in range(len(events)):
        if events.kind[e] == "ball" and {events.a[e], events.b[e]} == names and abs(events.t[e] - t) < SAME_MOMENT_TIME:
            return CandidateContact(one, record.ids[two], t, *(float(v[e]) for v in (
                events.t_sigma, events.probability, events.gap, events.gap_sigma)))  # fmt: skip
    k = int(np.argmin(np.abs(record.moments - t)))
    gap = float(np.hypot(*(record.path[k, two] - record.path[k, one]))) - 2 * record.table.ball_radius
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, [one, two]]), record.reach_sigma))
    return CandidateContact(one, record.ids[two], t, float("nan"), float(ndtr(-gap / sigma)), gap, sigma)


def _candidate_times(record: ShotRecord, one: int, two: int) -> list[float]:
    """List the times (s) of events between two balls, and of near passes of their paths."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    times = [float(events.t[e]) for e in range(len(events))
             if events.kind[e] == "ball" and {events.a[e], events.b[e]} == names]  # fmt: skip
    distance = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    speed = np.hypot(*(record.velocity[:, two] - record.velocity[:, one]).T)
    near = np.flatnonzero((distance < NEAR_PASS_RADII * record.table.ball_radius) & (speed > REST_SPEED))
    for group in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        if len(group):
            t = float(record.moments[group[np.argmin(distance[group])]])
            if all(abs(t - recorded) > SAME_MOMENT_TIME for recorded in times):
                times.append(t)
    return sorted(times)


def cut_ball_window(record: ShotRecord, t: float, ball: int, parties: set[str]) -> BallWindow:
    """Cut the samples of a ball around a time, from its last event before to its next one after.

    Args:
        record: The shot.
        t: s.
        ball: Index of the ball.
        parties: Names of the bodies that take part in the event at t.

    Returns:
        The window with initial guesses of the state.

    Raises:
        ValueError: If there are no samples before t.
    """
    events, end = record.events, t + WINDOW_TIME
    begin = max(t - WINDOW_TIME, float(record.moments[0]))
    for e in range(len(events)):
        event_parties = {events.a[e], events.b[e]} - {""}
        if record.ids[ball] not in event_parties or events.kind[e] == "rest":
            continue
        if (
            events.kind[e] in ("ball", "cushion")
            and event_parties == parties
            and abs(events.t[e] - t) < SAME_MOMENT_TIME
        ):
            continue
        guard = GUARD_SIGMAS * float(events.t_sigma[e])
        if events.t[e] <= t:
            begin = max(begin, min(float(events.t[e]) + guard, t))
        else:
            end = min(end, max(float(events.t[e]) - guard, t))
    samples = record.select_samples(ball, begin, end)
    return make_ball_window(samples, t, begin, record.state_at(ball, begin))
