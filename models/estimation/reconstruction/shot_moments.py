"""Moments of the explanation of a shot after its fit: times, and passes that may have been grazes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.capture_clock import CaptureClock
from models.core.events import Events, merge_events
from models.core.shot import ClosePass, ContactTestResult
from models.core.shot_explanation import MIN_LISTED_PROBABILITY, CauseHypothesis, Moment, ShotExplanation
from models.core.tracks import Tracks
from models.estimation.contact_test.candidate_contacts import evaluate_close_pass
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.reconstruction.contact_time_refinement import MAX_MOVE
from models.estimation.shot_hypotheses.event_evidence import EventEvidence
from models.estimation.shot_hypotheses.event_probability import estimate_event_probability

MAX_LOG_ODDS = 7.0
"""Limit of the logarithm of the odds of the contact test: its windows hold no more evidence about real balls."""


def align_moments(explanation: ShotExplanation, events: Events) -> ShotExplanation:
    """Take the refined times of contacts over from the events.

    Args:
        explanation: Explanation of the shot.
        events: Events with refined times.

    Returns:
        The explanation with the same times.
    """
    moments = []
    for moment in explanation.moments:
        same = [
            k
            for k in range(len(events))
            if events.kind[k] == "ball"
            and moment.best.cause == "ball"
            and {events.a[k], events.b[k]} == {moment.ball, moment.best.other}
            and abs(events.t[k] - moment.t) <= MAX_MOVE
        ]
        if same:
            k = min(same, key=lambda row: abs(events.t[row] - moment.t))
            moment = replace(moment, t=float(events.t[k]), t_sigma=float(events.t_sigma[k]))
        moments.append(moment)
    return replace(explanation, moments=tuple(sorted(moments, key=lambda one: one.t)))


def convert_times(explanation: ShotExplanation, clock: CaptureClock) -> ShotExplanation:
    """Convert the capture times of moments to presentation times.

    Args:
        explanation: Explanation in capture times.
        clock: Capture and presentation times of the frames.

    Returns:
        The explanation in presentation times.
    """
    t = np.array([moment.t for moment in explanation.moments])
    rate = clock.presentation_rate_at(t)
    shown = clock.presentation_time_at(t)
    moments = tuple(
        replace(moment, t=float(shown[k]), t_sigma=float(moment.t_sigma * rate[k]))
        for k, moment in enumerate(explanation.moments)
    )
    return replace(explanation, moments=moments)


def add_close_passes(
    events: Events, explanation: ShotExplanation, passes: tuple[ClosePass, ...], tracks: Tracks
) -> tuple[Events, ShotExplanation]:
    """Add passes of two balls that may have been contacts.

    Args:
        events: Events of the shot.
        explanation: Explanation of the shot.
        passes: The passes with the results of their contact tests.
        tracks: Tracks of the shot.

    Returns:
        The events with the contacts that are probable enough to be listed, and the explanation with all of them.
    """
    moments, rows = list(explanation.moments), []
    for one, two, result in ((each.one, each.other, each.result) for each in passes):
        hypotheses, p = _weigh_close_pass(tracks.ids[two], result)
        xy = np.array([np.interp(result.t, tracks.t, np.nan_to_num(tracks.xy[:, one, axis])) for axis in (0, 1)])
        moments.append(Moment(tracks.ids[one], result.t, result.t_sigma, xy, hypotheses, ("close_pass",)))
        if p >= MIN_LISTED_PROBABILITY:
            rows.append((one, two, result, p, xy))
    explanation = replace(explanation, moments=tuple(sorted(moments, key=lambda entry: entry.t)))
    return (_insert_contacts(events, rows, tracks) if rows else events), explanation


def reevaluate_close_passes(record: ShotRecord) -> ShotRecord:
    """Test the close passes of a recorded shot again, with the friction that the record knows.

    Args:
        record: Record with an explanation whose close passes are marked.

    Returns:
        The record with new probabilities of these passes; all other moments stay.
    """
    moments = []
    for moment in record.explanation.moments:
        other = next((one.other for one in moment.hypotheses if one.cause == "ball"), "")
        if "close_pass" in moment.doubts and {other, moment.ball} <= {*record.ids}:
            result = evaluate_close_pass(record, record.ids.index(moment.ball), record.ids.index(other), moment.t)
            if result is not None:
                moment = replace(moment, hypotheses=_weigh_close_pass(other, result)[0])
        moments.append(moment)
    return replace(record, explanation=replace(record.explanation, moments=tuple(moments)))


def _weigh_close_pass(other: str, result: ContactTestResult) -> tuple[tuple[CauseHypothesis, ...], float]:
    """Return the hypotheses of a close pass, the most probable first, and the probability of a contact."""
    odds = np.log(max(result.probability, 1e-12)) - np.log(max(1 - result.probability, 1e-12))
    evidence = EventEvidence(test=float(np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS)))
    p = estimate_event_probability("close_pass", evidence)
    contact = CauseHypothesis("ball", other, p, "close_pass", tuple(evidence.vector.tolist()))
    return tuple(sorted((contact, CauseHypothesis("none", "", 1 - p)), key=lambda entry: -entry.probability)), p


def _insert_contacts(
    events: Events, rows: list[tuple[int, int, ContactTestResult, float, np.ndarray]], tracks: Tracks
) -> Events:
    """Insert contacts of balls into events."""
    rows = sorted(rows, key=lambda row: row[2].t)
    results = [row[2] for row in rows]
    t = np.array([result.t for result in results])
    added = Events(
        ("ball",) * len(rows), t, np.array([max(result.t_sigma, 1e-6) for result in results]), tracks.frame_at(t),
        tuple(tracks.ids[row[0]] for row in rows), tuple(tracks.ids[row[1]] for row in rows),
        np.array([row[4] for row in rows]), np.array([row[3] for row in rows]),
        np.array([result.gap for result in results]), np.array([result.gap_sigma for result in results]),
        np.array([result.closing for result in results]),
    )  # fmt: skip
    merged = merge_events(events, added)
    return replace(merged, frame=tracks.frame_at(merged.t))
