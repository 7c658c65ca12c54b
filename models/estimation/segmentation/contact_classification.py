"""Classification of velocity changes: a strike, another ball, a cushion, or no known cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, ContactKind, Segment
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.segmentation.jitter_removal import STILL_RADII, fit_curve, select_samples
from models.estimation.segmentation.track_segmentation import BallSamples, SampleRange, SegmentFit, fit_segment

# Ball radii: tolerance of the distance between a centre and its contact line (calibration, cloth edge, soft rubber).
CUSHION_TOLERANCE = 0.6
# Ball radii: tolerance of the distance of two balls.
BALL_TOLERANCE = 0.45
# Ball radii: curves farther apart do not belong to one motion.
JUMP_DISTANCE = 0.4
# Classes of balls that a cue strikes, where a strike has to be attributed.
CUE_KINDS = ("cue", "white", "yellow")


@dataclass(frozen=True, slots=True)
class VelocityChange:
    """A change of velocity of one ball, between two of its samples."""

    ball: int
    segment_index: int
    """Index of the segment before, within the ball."""
    t: float
    t_before: float
    t_after: float
    """s: times of the samples before and after."""
    x: FloatArray
    velocity_before: FloatArray
    velocity_after: FloatArray
    """(2,) m and m/s."""
    from_rest: bool
    gain: float
    curve_before: SegmentFit
    curve_after: SegmentFit
    is_jump: bool
    """The curves before and after do not meet."""

    @property
    def difference(self) -> FloatArray:
        """Velocity after minus velocity before, (2,) m/s."""
        return self.velocity_after - self.velocity_before


@dataclass(frozen=True, slots=True)
class _CandidateCause:
    score: float
    kind: ContactKind
    changes: tuple[int, ...]
    cushion: str = ""


def cushion_distances(x: FloatArray, table: Table) -> FloatArray:
    """Return the distances from points to the four noses.

    Args:
        x: (..., 2) m.

    Returns:
        (..., 4) m, in the order of `CUSHIONS`; negative outside.
    """
    return np.stack([x[..., 0], table.length - x[..., 0], x[..., 1], table.width - x[..., 1]], axis=-1)


# (4, 2) unit normals of the noses, into the table.
INWARD_NORMALS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


def find_velocity_changes(
    ball: int, samples: BallSamples, parts: list[SampleRange], radius: float
) -> list[VelocityChange]:
    """Find times, places and velocities of the changes between successive parts of a track."""
    curves = [fit_curve(samples, part) for part in parts]
    changes: list[VelocityChange] = []
    for k, (one, two) in enumerate(pairwise(curves)):
        last, first = parts[k].last, parts[k + 1].first
        early, late = float(samples.t[last]), float(samples.t[first])
        t_best, x = _find_curve_crossing(samples, parts[k], parts[k + 1], one, two)
        if changes and t_best < changes[-1].t + 0.1 * (late - early):
            t_best = changes[-1].t + 0.1 * (late - early)
        distance = float(np.linalg.norm(one.position_at(t_best) - two.position_at(t_best)))
        is_certain = _has_enough_samples(parts[k]) and _has_enough_samples(parts[k + 1])
        is_jump = is_certain and distance > JUMP_DISTANCE * radius + 5 * float(np.median(samples.sigma))
        whole = select_samples(samples, SampleRange(parts[k].first, parts[k + 1].last, False))
        gain = fit_segment(whole, float(whole.t[0])).chi2 - one.chi2 - two.chi2
        before = np.zeros(2) if parts[k].static else _velocity_beside_change(samples, parts, k, one, t_best)
        after = np.zeros(2) if parts[k + 1].static else _velocity_beside_change(samples, parts, k + 1, two, t_best)
        changes.append(
            VelocityChange(ball, k, t_best, early, late, x, before, after, parts[k].static, gain, one, two, is_jump)
        )
    return changes


def assign_causes(changes: list[VelocityChange], table: Table) -> list[_CandidateCause]:
    """Assign the most plausible causes, each change to at most one; the others become `strike`, `jump` or `free`."""
    causes = _propose_ball_contacts(changes, table) + _propose_cushion_contacts(changes, table)
    used: set[int] = set()
    chosen = []
    for cause in sorted(causes, key=lambda c: c.score):
        if not used & set(cause.changes):
            used |= set(cause.changes)
            chosen.append(cause)
    for k, one in enumerate(changes):
        if k not in used:
            kind: ContactKind = "strike" if one.from_rest else "jump" if one.is_jump else "free"
            chosen.append(_CandidateCause(0.0, kind, (k,)))
    return chosen


def find_contact_opportunities(samples: BallSamples, others: list[BallSamples], table: Table) -> NDArray[np.bool_]:
    """Find between which samples of a ball a cue, a cushion or another ball may have changed its velocity.

    Args:
        samples: n samples of the ball.
        others: Samples of all other balls.

    Returns:
        (n - 1,) True where something is near.
    """
    step = np.linalg.norm(np.diff(samples.xy, axis=0), axis=1)
    ends = np.stack([samples.xy[:-1], samples.xy[1:]])  # (2, n-1, 2)
    slack = CUSHION_TOLERANCE * table.ball_radius + 0.6 * step
    is_near = (cushion_distances(ends, table).min(axis=(0, 2)) - table.ball_radius) < slack
    resting = np.ones(len(step), bool)
    resting[1:] = step[:-1] < STILL_RADII * table.ball_radius
    is_near |= resting & (step > STILL_RADII * table.ball_radius)
    middle = (samples.t[1:] + samples.t[:-1]) / 2
    for other in others:
        if len(other.t) < 2:
            continue
        other_place = np.stack([np.interp(middle, other.t, other.xy[:, k]) for k in (0, 1)], axis=1)
        other_step = np.interp(
            middle, (other.t[1:] + other.t[:-1]) / 2, np.linalg.norm(np.diff(other.xy, axis=0), axis=1)
        )
        reach = (2 + 2 * BALL_TOLERANCE) * table.ball_radius + 0.8 * (step + other_step)
        is_near |= np.linalg.norm(ends.mean(axis=0) - other_place, axis=1) < reach
    return np.asarray(is_near)


def _propose_ball_contacts(changes: list[VelocityChange], table: Table) -> list[_CandidateCause]:
    causes = []
    for i, one in enumerate(changes):
        for j in range(i + 1, len(changes)):
            two = changes[j]
            if one.ball == two.ball or not _overlap_in_time(one, two):
                continue
            if one.from_rest and two.from_rest and _is_hit_by_third_ball(one, two, changes, table.ball_radius):
                continue  # the third ball hit one of them, and that one perhaps the other
            score = _score_ball_contact(one, two, table.ball_radius)
            if np.isfinite(score):
                causes.append(_CandidateCause(score, "ball", (i, j)))
    return causes


def _is_hit_by_third_ball(
    one: VelocityChange, two: VelocityChange, changes: list[VelocityChange], radius: float
) -> bool:
    """Return whether a moving ball turns beside one of two balls that begin to move: then it has hit that one."""
    for third in changes:
        if third.from_rest or third.ball in (one.ball, two.ball):
            continue
        reach = 2 * (1 + BALL_TOLERANCE) * radius + 0.5 * float(np.linalg.norm(third.velocity_before)) * (
            third.t_after - third.t_before
        )
        for other in (one, two):
            if _overlap_in_time(third, other) and np.linalg.norm(third.x - other.x) < reach:
                return True
    return False


def _overlap_in_time(one: VelocityChange, two: VelocityChange) -> bool:
    """Return whether two velocity changes may be simultaneous."""
    if one.t_before > two.t_after + 0.7 * (two.t_after - two.t_before):
        return False
    return two.t_before <= one.t_after + 0.7 * (one.t_after - one.t_before)


def _score_ball_contact(one: VelocityChange, two: VelocityChange, radius: float) -> float:
    """Score two changes as one contact: below about 2 if plausible, infinite if impossible."""
    window = max(one.t_after - one.t_before, two.t_after - two.t_before)
    relative = float(np.linalg.norm(one.velocity_before - two.velocity_before))
    tolerance = BALL_TOLERANCE * radius + 0.5 * relative * min(one.t_after - one.t_before, two.t_after - two.t_before)
    separation = _separation_vector(one, two, 2 * radius)
    distance = float(np.hypot(*separation))
    normal = separation / max(distance, 1e-9)
    mismatch = abs(distance - 2 * radius) / tolerance
    total = np.linalg.norm(one.difference) + np.linalg.norm(two.difference)
    momentum = float(np.linalg.norm(one.difference + two.difference)) / max(float(total), 1e-6)
    separating = (two.velocity_after - one.velocity_after) @ normal
    late = abs(one.t - two.t) / window
    if (
        mismatch > 1
        or (momentum > 0.75 and not (one.from_rest and two.from_rest))
        or separating < -0.3 * relative - 0.05
    ):
        return np.inf
    return mismatch + momentum + 0.3 * late - 0.5


def _separation_vector(one: VelocityChange, two: VelocityChange, reach: float) -> FloatArray:
    """Return the vector (2,) from ball to ball at the better timed of two changes; its length is nearest to `reach` m.

    A ball that was missed for some frames may have met the other at any time meanwhile.
    """
    t = one.t if one.t_after - one.t_before <= two.t_after - two.t_before else two.t
    places = [[b.x, b.curve_before.position_at(t), b.curve_after.position_at(t)] for b in (one, two)]
    separations = np.array([b - a for a in places[0] for b in places[1]])
    nearest: FloatArray = separations[np.argmin(np.abs(np.linalg.norm(separations, axis=1) - reach))]
    return nearest


def _propose_cushion_contacts(changes: list[VelocityChange], table: Table) -> list[_CandidateCause]:
    causes = []
    for k, one in enumerate(changes):
        distance = cushion_distances(one.x, table) - table.ball_radius
        towards, away = -INWARD_NORMALS @ one.velocity_before, INWARD_NORMALS @ one.velocity_after
        speed = np.linalg.norm(one.velocity_before)
        tolerance = CUSHION_TOLERANCE * table.ball_radius + 0.35 * speed * (one.t_after - one.t_before)
        for side in range(4):
            along = abs(np.array([-INWARD_NORMALS[side, 1], INWARD_NORMALS[side, 0]]) @ one.difference)
            across = abs(INWARD_NORMALS[side] @ one.difference)
            if abs(distance[side]) < tolerance and towards[side] > 0.01 and away[side] > -0.2 * towards[side]:
                score = abs(distance[side]) / tolerance + along / (along + across + 1e-9) - 0.2
                causes.append(_CandidateCause(float(score), "cushion", (k,), CUSHIONS[side]))
    return causes


def build_contact_graph(
    samples: list[BallSamples], parts_by_ball: list[list[SampleRange]], table: Table, kinds: tuple[str, ...]
) -> ContactGraph:
    """Build the initial contact graph of a clip.

    Args:
        samples: Samples of N balls.
        parts_by_ball: Parts of each track, at rest or in motion.
        kinds: N ball classes.

    Returns:
        Segments of all balls, joined by the contacts that explain their velocity changes.
    """
    segments: list[Segment] = []
    index: dict[tuple[int, int], int] = {}
    changes: list[VelocityChange] = []
    for ball, (ball_samples, parts) in enumerate(zip(samples, parts_by_ball, strict=True)):
        for k, part in enumerate(parts):
            index[ball, k] = len(segments)
            segments.append(_make_segment(ball, ball_samples, part))
        changes += find_velocity_changes(ball, ball_samples, parts, table.ball_radius) if parts else []
    contacts: list[Contact] = []
    unobserved: dict[int, VelocityChange] = {}
    for cause in assign_causes(changes, table):
        members = [changes[k] for k in cause.changes]
        before = tuple(index[b.ball, b.segment_index] for b in members)
        after = tuple(index[b.ball, b.segment_index + 1] for b in members)
        t = (
            float(min(members, key=lambda b: b.t_after - b.t_before).t)
            if len({b.t_after - b.t_before for b in members}) > 1
            else float(np.mean([b.t for b in members]))
        )
        contact = Contact(cause.kind, t, before, after, cause.cushion, gain=sum(b.gain for b in members))
        for b, one, two in zip(members, before, after, strict=True):
            segments[one] = replace(segments[one], end=len(contacts))
            new_segment = _make_segment(b.ball, samples[b.ball], parts_by_ball[b.ball][b.segment_index + 1], t, b)
            segments[two] = replace(new_segment, start=len(contacts), end=segments[two].end)
        if cause.kind == "strike" and members[0].is_jump:
            unobserved[len(contacts)] = members[0]
        contacts.append(contact)
    graph = _insert_unobserved_runs(ContactGraph(tuple(segments), tuple(contacts)), unobserved)
    return _insert_strikes(graph, samples, table, kinds)


def _insert_unobserved_runs(graph: ContactGraph, unobserved: dict[int, VelocityChange]) -> ContactGraph:
    """Insert the motion of balls that rested, were lost and reappeared elsewhere: struck, then stopped by something."""
    segments, contacts = list(graph.segments), list(graph.contacts)
    for number, gap in unobserved.items():
        strike = contacts[number]
        rest, goal = strike.before[0], strike.after[0]
        margin = 0.2 * (gap.t_after - gap.t_before)
        start, stop = gap.t_before + margin, gap.t_after - margin
        goal_place = gap.curve_after.position_at(stop)
        v = (goal_place - segments[rest].state[:2]) / (stop - start)
        state = np.concatenate([segments[rest].state[:2], v, 0.1 * v, np.zeros(2)])
        run = Segment(gap.ball, False, number, len(contacts), start, state)
        arrived = segments[goal].state.copy()
        arrived[:2] = goal_place
        arrived[2:4] = 0.0 if segments[goal].static else gap.curve_after.velocity_at(stop)
        segments[goal] = replace(segments[goal], start=len(contacts), t0=stop, state=arrived)
        contacts[number] = Contact("strike", start, (rest,), (len(segments),), gain=strike.gain)
        contacts.append(Contact("free", stop, (len(segments),), (goal,), gain=strike.gain))
        segments.append(run)
    return ContactGraph(tuple(segments), tuple(contacts))


def _insert_strikes(
    graph: ContactGraph, samples: list[BallSamples], table: Table, kinds: tuple[str, ...]
) -> ContactGraph:
    """Insert a strike of one of two resting balls that part from each other."""
    segments, contacts = list(graph.segments), list(graph.contacts)
    for number, contact in enumerate(graph.contacts):
        if contact.kind != "ball" or not all(
            _waits_for_contact(segments, samples, contact, side, table) for side in (0, 1)
        ):
            continue
        cue = _select_struck_ball(segments, contact, kinds)
        other = 1 - cue
        rest, goal = segments[contact.before[cue]].state[:2], segments[contact.before[other]].state[:2]
        displacement = goal - rest
        gap = float(np.hypot(*displacement)) - 2 * table.ball_radius
        v = segments[contact.after[0]].state[2:4] + segments[contact.after[1]].state[2:4]
        speed = max(float(v @ displacement) / float(np.hypot(*displacement)), 0.1)
        if gap < 0.15 * table.ball_radius or _is_third_ball_moving(graph, contact):
            contacts[number] = replace(contact, driven=True)
            continue
        old = contact.before[cue]
        t = max(contact.t - gap / speed, (segments[old].t0 + contact.t) / 2)
        state = np.concatenate([rest, v, np.zeros(4)])
        segments.append(Segment(segments[old].ball, False, len(contacts), number, t, state))
        still = np.concatenate([rest, np.zeros(6)])
        start = segments[old].start if segments[old].static else None
        segments[old] = replace(segments[old], static=True, start=start, end=len(contacts), state=still)
        before = tuple(len(segments) - 1 if k == cue else contact.before[k] for k in range(2))
        contacts[number] = replace(contact, before=before)
        contacts.append(Contact("strike", t, (old,), (len(segments) - 1,), gain=contact.gain))
    return ContactGraph(tuple(segments), tuple(contacts))


def _is_third_ball_moving(graph: ContactGraph, contact: Contact) -> bool:
    """Return whether a third ball moves when two part: then it caused their motion, since no cue strikes meanwhile."""
    pair = graph.balls_at(contact)
    return any(
        not segment.static and segment.ball not in pair and graph.start_time(k) < contact.t < graph.end_time(k)
        for k, segment in enumerate(graph.segments)
    )


def _waits_for_contact(
    segments: list[Segment], samples: list[BallSamples], contact: Contact, side: int, table: Table
) -> bool:
    """Return whether a ball rests, or moves too little to reach the other one by itself."""
    segment, other = segments[contact.before[side]], segments[contact.after[1 - side]]
    if segment.static:
        return True
    gap = np.linalg.norm(other.state[:2] - segment.state[:2]) - 2 * table.ball_radius
    ball_samples = samples[segment.ball]
    rows = np.flatnonzero((ball_samples.t >= segment.t0) & (ball_samples.t < contact.t))
    travelled = float(np.linalg.norm(ball_samples.xy[rows[-1]] - ball_samples.xy[rows[0]])) if len(rows) else 0.0
    distance = max(travelled, float(np.linalg.norm(segment.state[2:4])) * (contact.t - segment.t0))
    return bool(segment.start is None and distance < 0.5 * gap)


def _select_struck_ball(segments: list[Segment], contact: Contact, kinds: tuple[str, ...]) -> int:
    """Select which of two balls (0 or 1) the cue hit: by class, else the one less aligned with the line of centres."""
    named = [kinds[segments[k].ball] in CUE_KINDS for k in contact.before]
    if named[0] != named[1]:
        return 0 if named[0] else 1
    line = segments[contact.before[1]].state[:2] - segments[contact.before[0]].state[:2]
    line /= np.hypot(*line)
    straight = []
    for k, sign in zip(contact.after, (-1, 1), strict=True):
        v = segments[k].state[2:4]
        straight.append(sign * float(v @ line) / max(float(np.hypot(*v)), 1e-6))
    return int(np.argmin(straight))


def _make_segment(
    ball: int, samples: BallSamples, part: SampleRange, t: float | None = None, start: VelocityChange | None = None
) -> Segment:
    """Make a segment with its state at time t, by default the time of its first sample."""
    selected = select_samples(samples, part)
    start_time = float(selected.t[0]) if t is None else t
    if part.static:
        return Segment(
            ball, True, None, None, start_time, np.concatenate([np.median(selected.xy, axis=0), np.zeros(6)])
        )
    if start is not None and part.last - part.first < 2:
        state = np.concatenate([start.x, start.velocity_after, np.zeros(4)])
        return Segment(ball, False, None, None, start_time, state)
    fit = fit_segment(selected, start_time)
    return Segment(ball, False, None, None, start_time, np.concatenate([fit.x, fit.v, fit.slip, np.zeros(2)]))


def _find_curve_crossing(
    samples: BallSamples, left: SampleRange, right: SampleRange, one: SegmentFit, two: SegmentFit
) -> tuple[float, FloatArray]:
    """Find when and where two successive curves meet: at their closest approach near the gap between their samples."""
    early, late = float(samples.t[left.last]), float(samples.t[right.first])
    slack = min(0.3 * (late - early), 0.5 * float(np.median(np.diff(samples.t))))
    t = np.linspace(early - slack, late + slack, 60)
    best = float(t[np.argmin(np.linalg.norm(one.position_at(t) - two.position_at(t), axis=1))])
    best = max(best, float(samples.t[left.first]) + 0.1 * (late - early))
    has_curve = [part.static or part.last - part.first >= 1 for part in (left, right)]
    if has_curve[0] == has_curve[1]:
        return best, (one.position_at(best) + two.position_at(best)) / 2
    # one sample gives no curve: use the other side
    middle = (early + late) / 2
    return middle, (one if has_curve[0] else two).position_at(middle)


def _has_enough_samples(part: SampleRange) -> bool:
    """Return whether a part has enough samples for a curve."""
    return part.static or part.last - part.first >= 2


def _velocity_beside_change(
    samples: BallSamples, parts: list[SampleRange], k: int, fit: SegmentFit, t: float
) -> FloatArray:
    """Return the velocity by the fit, or by the neighbouring samples if the part has only one."""
    part = parts[k]
    if part.last > part.first:
        return fit.velocity_at(t)
    before, after = max(part.first - 1, 0), min(part.last + 1, len(samples.t) - 1)
    mean: FloatArray = (samples.xy[after] - samples.xy[before]) / (samples.t[after] - samples.t[before])
    return mean
