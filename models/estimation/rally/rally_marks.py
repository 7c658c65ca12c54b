"""What a person corrected in a rally, taken as given: places of the object, and events that happened or did not.

Marked places replace the candidates of their frames. Marked events are worth so much evidence that explanations
without them lose; when exactly and where they were is left to the fit. What agrees with no flight is noted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.core.corrections import HAND_ODDS, HAND_TIME_FRAMES, TIME_FRAMES, BallMark, BallPlace, RallyCorrection
from models.core.rally import BallCandidates, Rally, RallyEvent
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.rally.event_evidence import name_contact
from models.estimation.rally.flight_observations import EventMark
from models.estimation.rally.rally_building import build_hit

# px, standard deviation of a place that a person pointed at: half of what is seen of the object. Guess.
HAND_PLACE_PX = 2.0
# px around a place within which what was tracked is no object: its looks measure three to eight.
FALSE_REACH_PX = 8.0
# Standard deviations by which a fitted time differs from the one that was set: as for contacts of billiards.
CONTRADICTION_SIGMAS = 3.0
# s from a mark to the flight that begins with it, where the object was not seen at once.
_LATE_START = 0.2


def correct_candidates(candidates: BallCandidates, marks: Sequence[BallMark]) -> BallCandidates:
    """Apply the marks of places: the only candidate of its frame, or none near a place for a span of frames."""
    stays = np.ones(len(candidates), np.bool_)
    for mark in marks:
        if mark.kind == "placed":
            stays &= candidates.frame != mark.ball.frame
        else:
            stays &= ~_are_false(mark, candidates.frame, candidates.centre)
    placed = [mark.ball for mark in marks if mark.kind == "placed"]
    sigma = np.full(len(placed), HAND_PLACE_PX)
    added = {
        "frame": np.array([one.frame for one in placed], np.int64),
        "centre": np.array([[one.x_px, one.y_px] for one in placed]).reshape(-1, 2),
        "streak": np.zeros((len(placed), 2)), "score": np.full(len(placed), HAND_ODDS / (1 + HAND_ODDS)),
        "sigma": sigma, "sigma_along": sigma,
    }  # fmt: skip
    columns = {name: np.concatenate([getattr(candidates, name)[stays], rows]) for name, rows in added.items()}
    order = np.argsort(columns["frame"], kind="stable")
    return replace(candidates, **{name: column[order] for name, column in columns.items()})


def _are_false(mark: BallMark, frame: IntArray, centre: FloatArray) -> BoolArray:
    """Find which places (K, 2) px in frames (K,) are no object by a mark of what is none."""
    first, last = mark.first or 0, np.inf if mark.last is None else mark.last
    is_near = np.linalg.norm(centre - [mark.ball.x_px, mark.ball.y_px], axis=1) < FALSE_REACH_PX
    return np.asarray(is_near & (frame >= first) & (frame <= last))


def resolve_places(marks: Sequence[BallMark], frame: IntArray) -> tuple[BallMark, ...]:
    """Move places that were marked in duplicate frames to the distinct frames (T,) that these show again.

    The last mark of a frame counts: a place is left out if a later one is in its frame, or says that it is no object.
    """
    resolved = list[BallMark]()
    for mark in marks:
        row = int(np.searchsorted(frame, mark.ball.frame, side="right")) - 1
        if mark.kind == "placed" and 0 <= row < len(frame) - 1:
            mark = replace(mark, ball=replace(mark.ball, frame=int(frame[row])))
        resolved = [one for one in resolved if one.kind == "false" or not _overrules(mark, one.ball)]
        resolved.append(mark)
    return tuple(resolved)


def _overrules(mark: BallMark, placed: BallPlace) -> bool:
    """Find out whether a mark takes back a place that was put before."""
    if mark.kind == "placed":
        return mark.ball.frame == placed.frame
    return bool(_are_false(mark, np.array([placed.frame]), np.array([[placed.x_px, placed.y_px]]))[0])


def choose_placed(chosen: IntArray, candidates: BallCandidates, frame: IntArray, marks: Sequence[BallMark]) -> IntArray:
    """Choose the marked place in each frame that has one; `chosen` (T,) are the candidates of frames (T,) so far."""
    chosen = chosen.copy()
    for mark in marks:
        if mark.kind == "placed":
            chosen[frame == mark.ball.frame] = np.searchsorted(candidates.frame, mark.ball.frame)
    return chosen


def resolve_marks(corrections: Sequence[RallyCorrection], frame: IntArray, t: FloatArray) -> tuple[EventMark, ...]:
    """Find the moments of corrected events; `frame` (T,) and `t` (T,), s, are those of the clip.

    Outside of the clip frames follow each other at its mean rate: what is marked there is no event of its last frame.
    """
    marks = list[EventMark]()
    if len(t) < 2:
        return ()
    interval, mean = float(np.median(np.diff(t))), float((t[-1] - t[0]) / (frame[-1] - frame[0]))
    sigma, reach = HAND_TIME_FRAMES * interval, TIME_FRAMES * interval
    for one in (part for correction in corrections for part in correction.split_move()):
        inside = min(max(one.frame, frame[0]), frame[-1])
        moment = float(np.interp(inside, frame, t)) + mean * float(one.frame - inside)
        marks.append(EventMark(one.event, moment, sigma, reach, one.kind == "mark"))
    return tuple(marks)


def find_contradicted(rally: Rally, marks: Sequence[EventMark]) -> list[EventMark]:
    """Find the marks of events that no flight allows."""
    return [
        mark
        for mark in marks
        if mark.is_there
        and not any(one.kind == mark.kind and mark.is_near(one.t) for one in rally.events)
        and (mark.kind != "hit" or _begin_flight(rally, mark) is None)
    ]


def settle_marks(rally: Rally, places: Sequence[BallMark], marks: Sequence[EventMark]) -> Rally:
    """Give marked events the probability of what a person saw, leave out deleted ones, and note what fits no flight."""
    events = list(rally.events)
    for mark in marks:
        near = [k for k, one in enumerate(events) if one.kind == mark.kind and mark.is_near(one.t)]
        if not mark.is_there:
            wanted = [one for one in marks if one.is_there and one.kind == mark.kind]
            gone = [k for k in near if not any(one.is_near(events[k].t) for one in wanted)]
            events = [one for k, one in enumerate(events) if k not in gone]
        elif near:
            k = min(near, key=lambda row: abs(events[row].t - mark.t))
            p = events[k].probability
            events[k] = replace(events[k], probability=p * HAND_ODDS / (1 - p + p * HAND_ODDS))
        elif mark.kind == "hit" and (hit := _begin_flight(rally, mark)) is not None:
            events = sorted([*events, hit], key=lambda one: one.t)
    notes = [*rally.notes, *filter(None, (note_contradiction(mark, events) for mark in marks))]
    placed = [one.ball.frame for one in places if one.kind == "placed"]
    lost = [frame for frame in placed if not rally.is_used[rally.frame == frame].any()]
    notes += [f"place-set-by-hand-in-frame-{frame}-fits-no-flight" for frame in lost]
    return _settle_landings(replace(rally, events=tuple(events), notes=tuple(notes)), marks)


def note_contradiction(mark: EventMark, events: Sequence[RallyEvent]) -> str:
    """Note how the events of a rally contradict a marked one; empty where they do not."""
    if not mark.is_there:
        return ""
    near = [one for one in events if one.kind == mark.kind and mark.is_near(one.t)]
    if not near:
        return f"{mark.kind}-set-by-hand-at-{mark.t:.2f}-s-fits-no-flight"
    own = min(near, key=lambda one: abs(one.t - mark.t))
    if abs(own.t - mark.t) <= CONTRADICTION_SIGMAS * np.hypot(mark.sigma, own.t_sigma):
        return ""
    return f"{mark.kind}-set-by-hand-at-{mark.t:.2f}-s-flies-as-if-at-{own.t:.2f}-s"


def _begin_flight(rally: Rally, mark: EventMark) -> RallyEvent | None:
    """Build the marked hit that begins a flight; None where no flight begins there."""
    for flight in rally.flights:
        if mark.is_near(flight.start) or 0 < flight.start - mark.t < _LATE_START:
            return build_hit(flight, flight.start - mark.t, mark.sigma, HAND_ODDS / (1 + HAND_ODDS), rally.scene.sport)
    return None


def _settle_landings(rally: Rally, marks: Sequence[EventMark]) -> Rally:
    """Weigh the landings by the marks of contacts with the ground."""
    own = [mark for mark in marks if mark.kind == name_contact(rally.scene.sport)]
    near = [[mark.is_there for mark in own if mark.is_near(one.t)] for one in rally.landings]
    odds = [HAND_ODDS if any(one) else 1 / HAND_ODDS if one else 1.0 for one in near]
    weights = np.array([*(one.weight for one in rally.landings), rally.no_landing]) * [*odds, 1.0]
    weights /= weights.sum()
    landings = [
        replace(one, weight=float(weights[k]), is_seen=one.is_seen or any(near[k]))
        for k, one in enumerate(rally.landings)
    ]
    landings.sort(key=lambda one: -one.weight)
    return replace(rally, landings=tuple(landings), no_landing=float(weights[-1]))
