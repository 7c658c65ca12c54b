"""Candidate contacts of balls and cushions in a recorded shot, each with its probability."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from models.core.shot import ClosePass, ContactTestResult
from models.estimation.contact_test.contact_moment import BallWindow, PossibleContact, make_ball_window
from models.estimation.contact_test.contact_probability import evaluate_contact
from models.estimation.contact_test.shot_record import ShotRecord

# s to either side of a moment: farther away, deviations of a table from the laws of rolling exceed the noise.
WINDOW_TIME = 0.4
# Standard deviations of its time that samples keep from another event.
GUARD_SIGMAS = 3.0
# Ball radii: paths that pass each other within it may have met.
NEAR_PASS_RADII = 0.25
# s: an event and a near pass so close in time are one moment.
SAME_MOMENT_TIME = 0.06
# m/s below which a ball looks at rest.
REST_SPEED = 0.02


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
    """Find every moment at which two balls may have touched, from the explanation of the shot.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        The moments, in order of time.
    """
    a, b = record.ids[one], record.ids[two]
    candidates: list[CandidateContact] = []
    for moment, probability in record.explanation.contacts_of(a, b):
        gap, gap_sigma = _gap_at(record, one, two, moment.t)
        candidate = CandidateContact(one, b, moment.t, moment.t_sigma, probability, gap, gap_sigma)
        if candidates and abs(candidates[-1].t - moment.t) < SAME_MOMENT_TIME:  # a moment of either ball lists it
            if candidates[-1].probability >= probability:
                continue
            candidates.pop()
        candidates.append(candidate)
    return candidates


def find_cushion_candidates(record: ShotRecord, one: int) -> list[CandidateContact]:
    """Find every moment at which a ball may have met a cushion, from the explanation of the shot.

    Args:
        record: The shot.
        one: Index of the ball.

    Returns:
        The moments, in order of time.
    """
    name, nan = record.ids[one], float("nan")
    return [
        CandidateContact(one, hypothesis.other, moment.t, moment.t_sigma, hypothesis.probability, nan, nan)
        for moment in record.explanation.moments
        if moment.ball == name
        for hypothesis in moment.hypotheses
        if hypothesis.cause == "cushion"
    ]


def find_unexplained_changes(record: ShotRecord, one: int) -> list[tuple[float, float]]:
    """Find when a moving ball changed its velocity for an unknown cause; a start that may be a strike is left out.

    A contact of two balls is a moment of one of them: of the other one, what is not that contact is unexplained.

    Args:
        record: The shot.
        one: Index of the ball.

    Returns:
        Time (s) and probability of each such moment.
    """
    name, changes = record.ids[one], {}
    for moment in record.explanation.moments:
        causes = {entry.cause: entry.probability for entry in moment.hypotheses}
        if "unexplained" not in causes or "strike" in causes:
            continue
        if moment.ball == name:
            changes[moment.t] = causes["unexplained"]
        elif (moment.best.cause, moment.best.other) == ("ball", name):
            changes.setdefault(moment.t, 1 - moment.best.probability)
    return list(changes.items())


def find_close_passes(record: ShotRecord) -> tuple[ClosePass, ...]:
    """Find where two balls pass each other so closely that they may have touched, and test that.

    Args:
        record: The shot.

    Returns:
        The passes with the results of the contact test; moments of listed contacts are left out.
    """
    passes = []
    for one in range(len(record.ids)):
        for two in range(one + 1, len(record.ids)):
            for t in _list_pass_times(record, one, two):
                result = evaluate_close_pass(record, one, two, t)
                if result is not None:
                    passes.append(ClosePass(one, two, result))
    return tuple(passes)


def evaluate_close_pass(record: ShotRecord, one: int, two: int, t: float) -> ContactTestResult | None:
    """Test whether two balls touched when they passed each other.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.
        t: s, about the time of the pass.

    Returns:
        The result; None with too few samples, or if the balls lie beside each other, so that neither comes nearer.
    """
    parties = {record.ids[one], record.ids[two]}
    with suppress(ValueError, np.linalg.LinAlgError):  # too few samples for a test
        balls = tuple(cut_ball_window(record, t, ball, parties) for ball in (one, two))
        question = PossibleContact(balls, 2 * record.table.ball_radius, record.reach_sigma, cloth=record.cloth)
        result = evaluate_contact(question, t)
        return result if result.t_sigma < WINDOW_TIME else None
    return None


def _gap_at(record: ShotRecord, one: int, two: int, t: float) -> tuple[float, float]:
    """Return the gap of two balls on free paths, and its sigma, m: of the event at t, else of the fitted paths."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    for e in range(len(events)):
        is_pair = events.kind[e] == "ball" and {events.a[e], events.b[e]} == names
        if is_pair and abs(events.t[e] - t) < SAME_MOMENT_TIME and np.isfinite(events.gap[e]):
            return float(events.gap[e]), float(events.gap_sigma[e])
    k = int(np.argmin(np.abs(record.moments - t)))
    return float(record.gaps(one, two)[k]), record.gap_sigma(one, two, k)


def _list_pass_times(record: ShotRecord, one: int, two: int) -> list[float]:
    """List the times (s) of near passes of two paths without a listed contact of the balls."""
    names = record.ids[one], record.ids[two]
    contact_times = [moment.t for moment, _ in record.explanation.contacts_of(*names)]
    distance = record.gaps(one, two)
    speed = np.hypot(*(record.velocity[:, two] - record.velocity[:, one]).T)
    near = np.flatnonzero((distance < NEAR_PASS_RADII * record.table.ball_radius) & (speed > REST_SPEED))
    times = []
    for group in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        if len(group):
            t = float(record.moments[group[np.argmin(distance[group])]])
            if all(abs(t - recorded) > SAME_MOMENT_TIME for recorded in contact_times):
                times.append(t)
    return times


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
