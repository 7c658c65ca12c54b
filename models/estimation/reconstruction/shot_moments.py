"""Moments of the explanation of a shot after its fit: times, and passes that may have been grazes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.capture_clock import CaptureClock
from models.core.events import Events, merge_events
from models.core.shot import ClosePass, ContactTestResult
from models.core.shot_explanation import MIN_LISTED_PROBABILITY, Moment, ShotExplanation
from models.core.tracks import Tracks
from models.estimation.shot_hypotheses.event_probability import weigh_close_pass


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
        hypotheses, p = weigh_close_pass(tracks.ids[two], result)
        xy = np.array([np.interp(result.t, tracks.t, np.nan_to_num(tracks.xy[:, one, axis])) for axis in (0, 1)])
        moments.append(Moment(tracks.ids[one], result.t, result.t_sigma, xy, hypotheses, ("close_pass",)))
        if p >= MIN_LISTED_PROBABILITY:
            rows.append((one, two, result, p, xy))
    explanation = replace(explanation, moments=tuple(sorted(moments, key=lambda entry: entry.t)))
    return (_insert_contacts(events, rows, tracks) if rows else events), explanation


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
