"""Marks of contacts with the balls and times that they name, and their prior odds on events and hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from models.core.corrections import (
    HAND_ODDS,
    HAND_TIME_FRAMES,
    PLACE_RADII,
    TIME_FRAMES,
    BallPlace,
    ContactCorrection,
    Corrections,
    TrackEdit,
)
from models.core.events import Events, merge_events
from models.core.fit_result import (
    MIN_LISTED_PROBABILITY,
    CauseHypothesis,
    MarkOutcome,
    MarkOutcomeCode,
    Moment,
    ShotExplanation,
)
from models.core.tracks import Tracks

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
        The corrections, in which every ball that is still found has the id that it has in `tracks`.
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


def weigh_marks(
    events: Events,
    explanation: ShotExplanation,
    marks: Sequence[ResolvedMark],
    outcomes: Sequence[MarkOutcome],
    tracks: Tracks,
) -> tuple[Events, ShotExplanation]:
    """Multiply the odds of marked contacts by those of a person, and divide those of deleted ones.

    Args:
        events: Events of the shot.
        explanation: Explanation of the shot.
        outcomes: The outcome of each mark.
        tracks: Tracks of N balls, at their capture times.

    Returns:
        The events that are probable enough to be listed, and the explanation. A marked contact that no event stands for
        is added, unless its bodies are too far apart.
    """
    for mark, outcome in zip(marks, outcomes, strict=True):
        odds = 1 / HAND_ODDS if mark.mark.kind == "delete" else HAND_ODDS
        if mark.mark.kind == "move" and abs(mark.earlier_t - mark.t) > mark.tolerance:
            events, explanation = _weigh_time(events, explanation, mark, mark.earlier_t, 1 / HAND_ODDS, tracks.ids)
        events, explanation = _weigh_time(events, explanation, mark, mark.t, odds, tracks.ids)
        is_listed = bool(_find_events(events, mark, mark.t, tracks.ids))
        if mark.mark.kind != "delete" and not is_listed and outcome.code != "too_far":
            events, explanation = _add_event(events, explanation, mark, tracks)
    return events, explanation


def _weigh_time(
    events: Events, explanation: ShotExplanation, mark: ResolvedMark, t: float, odds: float, ids: tuple[str, ...]
) -> tuple[Events, ShotExplanation]:
    """Multiply the odds of the contact of a mark at t, s, by a factor."""
    rows = _find_events(events, mark, t, ids)
    if odds > 1 and rows:
        rows = [min(rows, key=lambda k: abs(events.t[k] - t))]
    probability = events.probability.copy()
    for k in rows:
        probability[k] = _multiply_odds(float(probability[k]), odds)
    weighed = replace(events, probability=probability)
    is_listed = probability >= MIN_LISTED_PROBABILITY
    is_listed[~np.isin(np.arange(len(events)), rows)] = True
    moments = tuple(
        _weigh_moment(moment, mark, odds, ids) if abs(moment.t - t) <= mark.tolerance else moment
        for moment in explanation.moments
    )
    return weighed.select_rows(is_listed), replace(explanation, moments=moments)


def _weigh_moment(moment: Moment, mark: ResolvedMark, odds: float, ids: tuple[str, ...]) -> Moment:
    """Multiply the odds of the hypotheses of a moment that stand for the contact of a mark."""
    names = _name_bodies(mark, ids)
    concerned = [
        one.cause == mark.mark.cause and _is_same_contact(moment.ball, one.other, names) for one in moment.hypotheses
    ]
    before = sum(one.probability for one, is_own in zip(moment.hypotheses, concerned, strict=True) if is_own)
    if not any(concerned) or before <= 0:
        return moment
    after = _multiply_odds(before, odds)
    own, rest = after / before, (1 - after) / (1 - before) if before < 1 else 0.0
    hypotheses = [
        replace(one, probability=one.probability * (own if is_own else rest))
        for one, is_own in zip(moment.hypotheses, concerned, strict=True)
    ]
    if before >= 1:
        hypotheses.append(CauseHypothesis("none", "", 1 - after))
    return replace(moment, hypotheses=tuple(sorted(hypotheses, key=lambda one: -one.probability)))


def _add_event(
    events: Events, explanation: ShotExplanation, mark: ResolvedMark, tracks: Tracks
) -> tuple[Events, ShotExplanation]:
    """Add the contact of a mark that no event stands for: unlisted, it is as probable as the least that is listed."""
    p = _multiply_odds(MIN_LISTED_PROBABILITY, HAND_ODDS)
    interval = float(np.median(np.diff(tracks.t)))
    xy = np.array([np.interp(mark.t, tracks.t, np.nan_to_num(tracks.xy[:, mark.a, axis])) for axis in (0, 1)])
    a, other = tracks.ids[mark.a], mark.mark.cushion or (tracks.ids[mark.b] if mark.b != NO_BALL else "")
    row = float(np.interp(mark.t, tracks.t, tracks.frame))
    nan = float("nan")
    numbers = (np.array([value]) for value in (p, nan, nan, nan))
    added = Events(
        (mark.mark.cause,), np.array([mark.t]), np.array([HAND_TIME_FRAMES * interval]), np.array([row]),
        (a,), (other,), xy[None], *numbers,
    )  # fmt: skip
    hypotheses = (CauseHypothesis(mark.mark.cause, other, p), CauseHypothesis("none", "", 1 - p))
    moment = Moment(a, mark.t, HAND_TIME_FRAMES * interval, xy, hypotheses)
    moments = tuple(sorted((*explanation.moments, moment), key=lambda one: one.t))
    return merge_events(added, events), replace(explanation, moments=moments)


def _find_events(events: Events, mark: ResolvedMark, t: float, ids: tuple[str, ...]) -> list[int]:
    """Find the events that stand for the contact of a mark at t, s."""
    names = _name_bodies(mark, ids)
    return [
        k
        for k in range(len(events))
        if events.kind[k] == mark.mark.cause
        and _is_same_contact(events.a[k], events.b[k], names)
        and abs(events.t[k] - t) <= mark.tolerance
    ]


def _name_bodies(mark: ResolvedMark, ids: tuple[str, ...]) -> tuple[str, str]:
    return ids[mark.a], mark.mark.cushion or (ids[mark.b] if mark.b != NO_BALL else "")


def _is_same_contact(a: str, b: str, names: tuple[str, str]) -> bool:
    return (a, b) == names or (b, a) == names


def _multiply_odds(probability: float, factor: float) -> float:
    return probability * factor / (probability * factor + 1 - probability)
