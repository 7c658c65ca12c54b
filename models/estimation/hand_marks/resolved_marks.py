"""Marks of contacts with the balls and times that they name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from models.core.corrections import PLACE_RADII, BallPlace, ContactCorrection, Corrections, TrackEdit
from models.core.fit_result import MarkOutcome, MarkOutcomeCode
from models.core.tracks import Tracks

# Frame intervals within which a contact is the marked one: a person points at one of the two frames around it, and the
# fit may place it one further.
TIME_FRAMES = 2.5
# Odds of a mark of a person who looked at the frames: one in a thousand is a slip. Guess.
HAND_ODDS = 1000.0
# Frame intervals: standard deviation of a time that a person chose between two frames.
HAND_TIME_FRAMES = 0.5
NO_BALL = -1
Named = TypeVar("Named", ContactCorrection, TrackEdit)


@dataclass(frozen=True, slots=True)
class ResolvedMark:
    """A mark of a contact with the balls and times that it names."""

    mark: ContactCorrection
    a: int
    b: int
    """Numbers of the balls; `NO_BALL` for none."""
    t: float
    """s, capture time at which the contact is, or is not."""
    earlier_t: float
    """s, capture time from which it was moved; equal to `t` otherwise."""
    tolerance: float
    """s within which a contact is the marked one."""

    @property
    def balls(self) -> set[int]:
        """Numbers of the balls that take part."""
        return {self.a, self.b} - {NO_BALL}


def resolve_marks(
    marks: Sequence[ContactCorrection], tracks: Tracks
) -> tuple[tuple[ResolvedMark, ...], tuple[MarkOutcome, ...]]:
    """Find the balls and times that marks name.

    Args:
        marks: Marks of contacts.
        tracks: Tracks of N balls over T frames, at their capture times.

    Returns:
        The marks whose balls are tracked, and the outcomes of the others.
    """
    resolved, missing = [], []
    for mark in marks:
        a = find_tracked_ball(tracks, mark.ball)
        b = NO_BALL if mark.other is None else find_tracked_ball(tracks, mark.other)
        t, earlier_t = (float(np.interp(frame, tracks.frame, tracks.t)) for frame in (mark.at, mark.frame))
        interval = float(np.median(np.diff(tracks.t))) if len(tracks.t) > 1 else 0.0
        if a is None or b is None or a == b:
            missing.append(MarkOutcome(mark.kind, "ball_missing", _name_places(mark), mark.cushion, t))
        else:
            resolved.append(ResolvedMark(mark, a, b, t, earlier_t, TIME_FRAMES * interval))
    return tuple(resolved), tuple(missing)


def find_tracked_ball(tracks: Tracks, place: BallPlace) -> int | None:
    """Find the ball that a place names.

    Args:
        tracks: Tracks of N balls over T frames.
        place: A place in the image.

    Returns:
        Number of the nearest ball; None if none is within `PLACE_RADII`.
    """
    best, number = PLACE_RADII, None
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if not len(rows):
            continue
        distance = place.measure_distance(
            place.frame, tracks.frame[rows], tracks.px[rows, ball], tracks.radius_px[rows, ball]
        )
        if distance < best:
            best, number = distance, ball
    return number


def update_ball_names(corrections: Corrections, tracks: Tracks) -> Corrections:
    """Replace the ids in corrections by those that the balls have now, where a correction names balls that exist.

    A renamed, joined or split ball keeps the id that it had: the correction is about that id.

    Args:
        corrections: What a person corrected.
        tracks: Tracks of N balls over T frames.

    Returns:
        The corrections with ids of `tracks`.
    """

    def update(place: BallPlace) -> BallPlace:
        ball = find_tracked_ball(tracks, place)
        return place if ball is None else replace(place, id=tracks.ids[ball])

    def update_both(one: Named) -> Named:
        return replace(one, ball=update(one.ball), other=None if one.other is None else update(one.other))

    edits = tuple(update_both(one) if one.kind in ("class", "swap") else one for one in corrections.tracks)
    return replace(corrections, tracks=edits, contacts=tuple(update_both(one) for one in corrections.contacts))


def describe_outcome(
    resolved: ResolvedMark, ids: tuple[str, ...], code: MarkOutcomeCode, value: float = float("nan")
) -> MarkOutcome:
    """Describe what the motion says about a mark.

    Args:
        resolved: The mark.
        ids: Ids of the N balls.
        code: The outcome.
        value: Its value, see `MarkOutcome.value`.

    Returns:
        The outcome.
    """
    names = tuple(ids[ball] for ball in (resolved.a, resolved.b) if ball != NO_BALL)
    return MarkOutcome(resolved.mark.kind, code, names, resolved.mark.cushion, resolved.t, value)


def _name_places(mark: ContactCorrection) -> tuple[str, ...]:
    return tuple(place.id for place in (mark.ball, mark.other) if place is not None)
