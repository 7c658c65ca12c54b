"""Scores of one case: what the program stated, what was to be found, and motion without a cause."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from benchmarks.stress_cases.ball_matching import BallMatch, match_balls, match_events
from benchmarks.stress_cases.shot_truth import ShotTruth, TrueEvent
from benchmarks.stress_cases.stress_chain import UNDECIDED, Call, FittedShot, answer_calls
from benchmarks.stress_cases.uncaused_motion import find_speed_changes
from models.core.events import Events
from models.core.typing import IntArray

# Distance within which the nearest true event is named beside a wrong one.
NEAR_FRAMES = 30.0


@dataclass(frozen=True, slots=True)
class Case:
    """Where a row comes from."""

    group: str
    clip: str
    damage: str
    seed: int


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement with its probability; `is_true` is None where the truth does not tell."""

    case: Case
    topic: str
    text: str
    probability: float
    undecided: bool
    is_true: bool | None
    truth: str


@dataclass(frozen=True, slots=True)
class Sought:
    """A sure true event, whether it was found, and whether it was listed as undecided."""

    case: Case
    text: str
    found: bool
    undecided: bool


@dataclass(frozen=True, slots=True)
class Motion:
    """A start or turn of a ball; see `SpeedChange`."""

    case: Case
    text: str
    caused: bool
    marked: bool


@dataclass(frozen=True, slots=True)
class Crash:
    """A case that raised."""

    case: Case
    text: str


@dataclass(slots=True)
class Scores:
    """Rows of all cases."""

    cases: list[Case] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    sought: list[Sought] = field(default_factory=list)
    motions: list[Motion] = field(default_factory=list)
    crashes: list[Crash] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)

    def add(self, other: Scores) -> None:
        """Append the rows of other scores."""
        for name in ("cases", "statements", "sought", "motions", "crashes", "skipped"):
            getattr(self, name).extend(getattr(other, name))


def score_case(case: Case, shot: FittedShot, truth: ShotTruth, kept: IntArray | None = None) -> Scores:
    """Score the result of one case.

    Args:
        case: Where it comes from.
        shot: Tracks and fit.
        truth: The true events, in the frame numbers of the tracks.
        kept: Frames that were left when frames were removed; None where none was.

    Returns:
        Its rows.
    """
    match, radius = match_balls(truth, shot), shot.recording.scene.table.ball_radius
    events, start = shot.fit.events, -np.inf if kept is None else float(kept[0])
    frame_s = float(np.median(np.diff(shot.tracks.t) / np.diff(shot.tracks.frame)))
    matched = match_events(events, truth, match, kept, frame_s, radius)
    scores = Scores(cases=[case])
    found = {e: k for k, e in enumerate(matched) if e is not None}
    for e, event in enumerate(truth.events):
        if event.certainty == "sure" and event.lo >= start:
            p = float(events.probability[found[e]]) if e in found else 0.0
            is_found, undecided = p >= UNDECIDED[0], UNDECIDED[0] <= p < UNDECIDED[1]
            text = str(event) if is_found else f"{event}; {_describe_nearest_report(events, event)}"
            scores.sought.append(Sought(case, text, is_found, undecided))
    for k in range(len(events)):
        if events.kind[k] != "rest":
            scores.statements.append(_score_event(case, shot, truth, match, matched, k))
    movers = {name for k, name in enumerate(shot.tracks.ids) if shot.fit.moving[:, k].any()} | set(match.names)
    strikes = [match.a[e] for e, event in enumerate(truth.events) if event.kind == "strike" and event.a == truth.cue]
    cues = sorted(next(filter(None, strikes), match.ids_of(truth.cue or "")))
    if not truth.complete or truth.spans:  # these calls could not be judged
        movers = set()
    movers &= {track for track in shot.tracks.ids if _may_move(track, shot, truth, match)}
    for call in answer_calls(shot.tracks, shot.recording.scene, shot.fit, cues[:1], movers):
        is_true, text = judge_call(call, truth, match, start)
        said = f"{call.question} {' '.join(call.balls)}: {call.answer}"
        scores.statements.append(Statement(case, call.question, said, call.probability, call.undecided, is_true, text))
    scores.motions += [
        Motion(case, f"{one.ball} {one.kind} at frame {one.frame:.1f}", one.caused, one.marked)
        for one in find_speed_changes(shot)
    ]
    return scores


def _describe_nearest_report(events: Events, event: TrueEvent) -> str:
    """Describe the reported event of the same kind that is nearest in time to one that was not found."""
    own = [k for k in range(len(events)) if events.kind[k] == event.kind]
    if not own:
        return f"no {event.kind} reported"
    k = min(own, key=lambda k: abs(events.frame[k] - (event.lo + event.hi) / 2))
    balls = f"{events.a[k]} {events.b[k]}".strip()
    return f"nearest reported: {balls} at {events.frame[k]:.2f} ({events.probability[k]:.3f})"


def _may_move(track: str, shot: FittedShot, truth: ShotTruth, match: BallMatch) -> bool:
    """Return whether a ball moves in the fit or in truth."""
    name = match.names.get(track)
    return bool(shot.fit.moving[:, shot.tracks.ids.index(track)].any()) or any(
        name is not None and name in (event.a, event.b) for event in truth.events
    )


def _score_event(
    case: Case, shot: FittedShot, truth: ShotTruth, match: BallMatch, matched: list[int | None], k: int
) -> Statement:
    events = shot.fit.events
    frame, p = float(events.frame[k]), float(events.probability[k])
    said = f"{events.kind[k]} {events.a[k]}{' - ' + events.b[k] if events.b[k] else ''} at frame {frame:.2f}"
    is_true: bool | None = False
    event = matched[k]
    if event is not None:
        is_true, text = (True if truth.events[event].certainty == "sure" else None), str(truth.events[event])
    else:
        is_true = False if truth.is_complete_at(frame) else None
        text = _describe_nearest(truth, match, events.kind[k], {events.a[k], events.b[k]}, frame)
    return Statement(case, "event", said, p, UNDECIDED[0] < p < UNDECIDED[1], is_true, text)


def _describe_nearest(truth: ShotTruth, match: BallMatch, kind: str, balls: set[str], frame: float) -> str:
    """Describe the true event that a wrong one may be meant to be."""
    near = [
        (abs(frame - (event.lo + event.hi) / 2) + 10 * (event.kind != kind), str(event))
        for e, event in enumerate(truth.events)
        if balls & (match.a[e] | match.b[e]) and abs(frame - (event.lo + event.hi) / 2) < NEAR_FRAMES
    ]
    names = ", ".join(f"{ball} is {match.names.get(ball, 'unnamed')}" for ball in sorted(balls - {""}))
    return f"none; nearest: {min(near)[1] if near else 'none'}; {names}"


def judge_call(call: Call, truth: ShotTruth, match: BallMatch, start: float) -> tuple[bool | None, str]:
    """Judge an answer to an umpire's question.

    Args:
        call: The answer.
        truth: The true events.
        match: Tracks of the true balls.
        start: First frame that the program has seen.

    Returns:
        Whether it is true, None where the truth does not tell, and the truth in words.
    """
    if call.question == "first":
        return _judge_first(call, truth, match, start)
    if call.question == "cushion-first":
        return _judge_cushion_first(truth, start)
    if not truth.complete or truth.spans:
        return None, "the labels are not complete"
    if call.question == "contact":
        return _judge_contact(call, truth, match, start)
    return _judge_pocket(call, truth, match, start)


def _judge_first(call: Call, truth: ShotTruth, match: BallMatch, start: float) -> tuple[bool | None, str]:
    if truth.first is None:
        return None, "unknown"
    if truth.first == "none":
        return call.answer == "none", "it touched no ball"
    ids = match.ids_of(truth.first)
    if not ids and call.answer not in match.names and call.answer != "none":
        return None, f"{truth.first}, which has no track"
    own = [e for e in truth.events if e.kind == "ball" and {e.a, e.b} == {truth.cue, truth.first}]
    before = ", before the first frame" if own and own[0].lo < start else ""
    return call.answer in ids, f"{truth.first} ({', '.join(sorted(ids)) or 'no track'}){before}"


def _judge_cushion_first(truth: ShotTruth, start: float) -> tuple[bool | None, str]:
    cue = truth.cue
    for event in truth.events:
        if event.kind in ("ball", "cushion") and cue in (event.a, event.b):
            rivals = [e for e in truth.events if e.kind != event.kind and cue in (e.a, e.b) and e.lo < event.hi]
            rivals = [e for e in rivals if e.kind in ("ball", "cushion")]
            if event.certainty != "sure" or rivals:
                return None, "unknown"
            return event.kind == "cushion", f"{event}{', before the first frame' if event.lo < start else ''}"
    return (False, "neither ball nor cushion") if truth.complete and not truth.spans else (None, "unknown")


def _judge_contact(call: Call, truth: ShotTruth, match: BallMatch, start: float) -> tuple[bool | None, str]:
    """Judge whether two balls touched; unknown where a soft contact, another track or a lost ball would decide."""
    one, two = call.balls
    names = {match.names.get(one), match.names.get(two)}
    for e, event in enumerate(truth.events):
        if event.kind != "ball":
            continue
        a, b = match.a[e], match.b[e]
        if event.certainty == "sure" and event.lo >= start and ((one in a and two in b) or (two in a and one in b)):
            return True, str(event)
    for e, event in enumerate(truth.events):
        if event.kind != "ball":
            continue
        lost = {name for name, ids in ((event.a, match.a[e]), (event.b, match.b[e])) if not ids}
        if {event.a, event.b} == names or (None in names and lost and (names | lost) >= {event.a, event.b}):
            return None, f"unknown: {event}"
    return False, "they did not touch"


def _judge_pocket(call: Call, truth: ShotTruth, match: BallMatch, start: float) -> tuple[bool | None, str]:
    name = match.names.get(call.balls[0])
    own = [e for e, event in enumerate(truth.events) if event.kind == "pocket" and event.a == name]
    if own:
        event = truth.events[own[0]]
        if event.certainty != "sure" or event.lo < start or call.balls[0] not in match.a[own[0]]:
            return None, f"unknown: {event}"
        return event.b == call.answer, str(event)
    if name is None and any(not match.a[e] for e, event in enumerate(truth.events) if event.kind == "pocket"):
        return None, "a pocketed ball has no track"
    return False, "it stayed on the table"
