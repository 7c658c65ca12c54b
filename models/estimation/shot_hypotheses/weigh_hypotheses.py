"""Weights of the hypotheses of a shot: every event with its rivals, and every velocity change without a cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import CAUSELESS_KINDS, JointSolution, Observations, layout_parameters
from models.core.fit_result import (
    MIN_LISTED_PROBABILITY,
    BallPremise,
    Cause,
    CauseHypothesis,
    Doubt,
    Moment,
    RackBreak,
    ShotExplanation,
)
from models.core.options import REQUIRED_GAIN
from models.core.scene import Table
from models.core.shot import ContactRivals, RivalContact
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import evaluate_state, find_segment_at
from models.estimation.joint_fit.fit_solution import assign_observations, end_state
from models.estimation.shot_hypotheses.event_probability import (
    EDGE_FRAMES,
    GRAZE_GAP,
    SLOW_SPEED,
    EventEvidence,
    EventRow,
    compress_gain,
    compress_rival,
    count_missed_frames,
    estimate_event_probability,
)

# Frame intervals: largest uncertainty of the time of a velocity change; the samples around it show that much.
MAX_TIME_FRAMES = 2.0
# Frame intervals: least uncertainty of the time of a rival contact.
RIVAL_TIME_SHARE = 0.25
# m/s below which a ball counts as at rest when it is first detected.
REST_SPEED = 0.05
# m/s from which another ball counts as moving: slower ones may be measurement errors.
DRIVING_SPEED = 0.1
# Missed frames, and ball radii between two frames, from which they are named as a doubt.
HIDDEN_FRAMES, FAST_RADII = 1.0, 4.0


@dataclass(frozen=True, slots=True)
class _Shot:
    """What evidence is collected from."""

    solution: JointSolution
    hypotheses: tuple[ContactRivals, ...]
    tracks: Tracks
    table: Table
    chi2: FloatArray
    """(S,) per degree of freedom of each segment."""
    count: FloatArray
    """(S,) samples of each segment."""
    interval: float


def weigh_events(
    rows: list[EventRow],
    solution: JointSolution,
    observations: Observations,
    tracks: Tracks,
    table: Table,
    chi2: FloatArray,
    hypotheses: tuple[ContactRivals, ...],
    breaks: tuple[RackBreak, ...],
    hidden: set[int],
    premises: Mapping[str, BallPremise],
) -> tuple[list[EventRow], ShotExplanation]:
    """Weigh all events, their rivals, and velocity changes without a cause.

    Args:
        rows: Events of the best explanation.
        solution: That explanation.
        observations: K observations.
        tracks: Tracks of N balls.
        chi2: (S,) chi2 per degree of freedom of each segment.
        hypotheses: (C,) what may have happened instead of each contact.
        hidden: Contacts in the breaks that no frame shows.
        premises: What the events of each ball rest on.

    Returns:
        The events that are probable enough to be listed, with their probabilities, and all hypotheses.
    """
    owner = assign_observations(solution.graph, observations)
    count = np.bincount(owner, minlength=len(solution.graph.segments)).astype(float)
    shot = _Shot(solution, hypotheses, tracks, table, chi2, count, observations.frame_interval)
    likely: list[EventRow] = []
    moments: list[Moment] = []
    explained = set(hidden)
    for row in rows:
        rivals = _find_rivals(shot, row)
        evidence = _collect_evidence(shot, row, rivals)
        p = estimate_event_probability(row.category, evidence) if row.category else row.probability
        weighed = _weigh_premises(
            premises, [(replace(row, probability=p), evidence), *_weigh_rivals(shot, row, rivals, evidence, 1 - p)]
        )
        likely += [one for one, _ in weighed if one.probability >= MIN_LISTED_PROBABILITY]
        moments.append(_make_moment(shot, weighed, evidence))
        if others := [one for one in weighed if one[0].a != row.a]:  # rivals for the other ball of the contact
            mirrored = replace(weighed[0][0], a=row.b, b=row.a)
            moments.append(_make_moment(shot, [(mirrored, evidence), *others], evidence))
        if row.kind != "rest":
            explained.add(row.contact)
    for number, contact in enumerate(solution.graph.contacts):
        if contact.kind in CAUSELESS_KINDS and number not in explained:
            change = _describe_change(shot, number)
            rivals = hypotheses[number].rivals
            evidence = _collect_evidence(shot, change, rivals)
            weighed = _weigh_premises(premises, _weigh_rivals(shot, change, rivals, evidence, 1.0))
            likely += [one for one, _ in weighed if one.probability >= MIN_LISTED_PROBABILITY]
            moments.append(_make_moment(shot, [(replace(change, probability=0.0), evidence), *weighed], evidence))
    moments.sort(key=lambda one: one.t)
    moving = _find_moving_at_start(solution, tracks.ids, table.ball_radius)
    return likely, ShotExplanation(tuple(moments), moving, breaks, premises)


def _weigh_premises(
    premises: Mapping[str, BallPremise], weighed: list[tuple[EventRow, EventEvidence]]
) -> list[tuple[EventRow, EventEvidence]]:
    """Multiply the probability of each event by that of what it rests on."""
    explanation = ShotExplanation(premises=premises)
    return [
        (replace(row, probability=row.probability * explanation.premise_probability(row.a, row.b)), evidence)
        for row, evidence in weighed
    ]


def _find_moving_at_start(solution: JointSolution, ids: tuple[str, ...], radius: float) -> tuple[str, ...]:
    """Find the balls that move from their first sample on.

    Args:
        ids: N ids of balls.
        radius: m, of the balls: one that touches nothing and rests before it moved so far lies where it lay, whether it
            rolled out or its first samples are bad.

    Returns:
        Their ids.
    """
    balls = []
    for k, segment in enumerate(solution.graph.segments):
        if segment.start is None and not segment.static and np.hypot(*segment.state[2:4]) > REST_SPEED:
            way = float(np.hypot(*(end_state(solution, k) - segment.state[:6])[:2]))
            balls += [ids[segment.ball]] * (segment.end is not None or way > radius)
    return tuple(balls)


def _find_rivals(shot: _Shot, row: EventRow) -> tuple[RivalContact, ...]:
    """Find the rivals of an event that belongs to a fitted contact."""
    if row.contact < 0 or row.kind in ("rest", "pocket") or row.category in ("", "passing"):
        return ()
    return shot.hypotheses[row.contact].rivals


def _describe_change(shot: _Shot, number: int) -> EventRow:
    """Describe a velocity change without a cause as a row that is no event."""
    graph = shot.solution.graph
    contact = graph.contacts[number]
    after = graph.segments[contact.after[0]]
    column = layout_parameters(graph).contact + number
    variance = max(float(shot.solution.covariance[column, column]), 0.0)
    sigma = min(float(np.sqrt(variance)), MAX_TIME_FRAMES * shot.interval)
    return EventRow(
        "strike", contact.t, sigma, shot.tracks.ids[after.ball], "", after.state[:2], "rival", number,
        speed=float(np.hypot(*after.state[2:4])),
    )  # fmt: skip


def _weigh_rivals(
    shot: _Shot, row: EventRow, rivals: tuple[RivalContact, ...], evidence: EventEvidence, rest: float
) -> list[tuple[EventRow, EventEvidence]]:
    """Weigh the rivals of an event; together they are at most as probable as `rest`."""
    ids = shot.tracks.ids
    rows = []
    for rival in rivals:
        own = replace(evidence, gain=0.0, rival=0.0, fit=compress_rival(rival.cost), graze=0.0, slow=0.0, apart=0.0)
        p = estimate_event_probability("rival", own)
        t_sigma = max(row.t_sigma, RIVAL_TIME_SHARE * shot.interval)
        names = ids[rival.ball], ids[rival.other]
        rows.append((EventRow("ball", row.t, t_sigma, *names, row.xy, "rival", row.contact, p), own))
    total = sum(one.probability for one, _ in rows)
    share = min(rest / total, 1.0) if total else 0.0
    return [(replace(one, probability=one.probability * share), own) for one, own in rows]


def _collect_evidence(shot: _Shot, row: EventRow, rivals: tuple[RivalContact, ...]) -> EventEvidence:
    """Collect the evidence on an event of the best explanation."""
    solution, graph, radius = shot.solution, shot.solution.graph, shot.table.ball_radius
    t_first, t_last = float(shot.tracks.t[0]), float(shot.tracks.t[-1])
    balls = [shot.tracks.ids.index(name) for name in (row.a, row.b) if name in shot.tracks.ids]
    hidden = [
        count_missed_frames(shot.tracks.t[shot.tracks.is_observed[:, ball]], row.t, shot.interval) for ball in balls
    ]
    edge = min(row.t - t_first, t_last - row.t) < EDGE_FRAMES * shot.interval
    own = EventEvidence(hidden=float(np.log1p(max(hidden, default=0.0))), edge=float(edge))
    speed = 0.0 if np.isnan(row.speed) else row.speed
    if row.contact < 0 and row.kind != "rest":
        return replace(own, travel=float(np.log1p(speed * shot.interval / radius)))
    if row.contact < 0:  # the ball rolls out
        return replace(own, **_assess_segments(shot, [find_segment_at(graph, balls[0], row.t)]))
    contact = graph.contacts[row.contact]
    around = [*contact.before, *contact.after]
    speeds = [np.hypot(*end_state(solution, k)[2:4]) for k in contact.before]
    speeds += [np.hypot(*graph.segments[k].state[2:4]) for k in contact.after]
    is_contact = row.kind in ("ball", "cushion")
    apart = 0.0
    if row.kind == "ball" and contact.kind == "ball":
        apart = -shot.hypotheses[row.contact].separation_cost
    return replace(
        own,
        gain=compress_gain(contact.gain),
        apart=compress_gain(apart),
        rival=max((compress_rival(rival.cost) for rival in rivals), default=0.0),
        travel=float(np.log1p(max(speeds) * shot.interval / radius)),
        graze=float(np.exp(-max(-row.gap, 0.0) / GRAZE_GAP)) if np.isfinite(row.gap) else 0.0,
        slow=float(np.exp(-max(row.speed, 0.0) / SLOW_SPEED)) if is_contact and np.isfinite(row.speed) else 0.0,
        driven=float(row.kind == "strike" and _is_other_moving(shot, row)),
        **_assess_segments(shot, around),
    )


def _assess_segments(shot: _Shot, around: list[int]) -> dict[str, float]:
    """Assess how well the motion before and after an event is fitted, and how many samples show it."""
    chi2 = shot.chi2[around]
    moving = [k for k in around if not shot.solution.graph.segments[k].static]
    samples = min((float(shot.count[k]) for k in moving), default=np.inf)
    misfit = float(np.log(max(np.nanmax(chi2) if np.isfinite(chi2).any() else 1.0, 1.0)))
    return {"misfit": misfit, "short": float(1 / (1 + samples))}


def _is_other_moving(shot: _Shot, row: EventRow) -> bool:
    """Return whether another ball moves clearly when a ball starts."""
    graph, friction, own = shot.solution.graph, shot.solution.friction, shot.tracks.ids.index(row.a)
    others = (k for k, segment in enumerate(graph.segments) if not segment.static and segment.ball != own)
    around = (k for k in others if graph.start_time(k) < row.t < graph.end_time(k))
    return any(np.hypot(*evaluate_state(graph, friction, k, row.t)[2:4]) > DRIVING_SPEED for k in around)


def _make_moment(shot: _Shot, weighed: list[tuple[EventRow, EventEvidence]], evidence: EventEvidence) -> Moment:
    """Make the moment of an event, the first of `weighed`, and its rivals; the remaining weight has no known cause."""
    main = weighed[0][0]
    hypotheses = []
    for row, own in weighed:
        a, other = (row.a, row.b) if row.a == main.a else (row.b, row.a)
        if row.probability > 0 and a == main.a:
            hypotheses.append(
                CauseHypothesis(_cause_of(row), other, row.probability, row.category, tuple(own.vector.tolist()))
            )
    rest = max(1 - sum(one.probability for one in hypotheses), 0.0)
    contact = shot.solution.graph.contacts[main.contact] if main.contact >= 0 else None
    is_certain = contact is not None and (contact.kind in CAUSELESS_KINDS or contact.gain >= REQUIRED_GAIN)
    hypotheses.append(CauseHypothesis("unexplained" if is_certain else "none", "", rest))
    doubts: list[Doubt] = []
    for is_doubt, doubt in (
        (np.expm1(evidence.hidden) >= HIDDEN_FRAMES, "hidden"),
        (np.expm1(evidence.travel) >= FAST_RADII, "fast"),
        (evidence.short >= 1 / 3, "few_samples"),
        (evidence.edge > 0, "clip_edge"),
        (any(one.probability >= MIN_LISTED_PROBABILITY for one, _ in weighed[1:]), "rival"),
        (main.probability == 0.0, "no_cause"),
    ):
        if is_doubt:
            doubts.append(doubt)  # type: ignore[arg-type]
    ordered = tuple(sorted(hypotheses, key=lambda one: -one.probability))
    return Moment(main.a, main.t, main.t_sigma, main.xy, ordered, tuple(doubts))


def _cause_of(row: EventRow) -> Cause:
    """Return the cause that an event stands for."""
    return row.kind  # type: ignore[return-value]
