"""Events of a refined contact graph, each with time, error, probability and margin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import (
    SEGMENT_STATE_SIZE,
    ClothFriction,
    Contact,
    JointSolution,
    ParameterLayout,
    layout_parameters,
)
from models.core.events import Events
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import evaluate_state, find_segment_at
from models.estimation.joint_fit.fit_solution import end_state
from models.estimation.reconstruction.trajectory_assembly import state_covariance
from models.estimation.segmentation.contact_classification import (
    BALL_TOLERANCE,
    CUE_KINDS,
    INWARD_NORMALS,
    cushion_distances,
)
from models.estimation.shot_hypotheses.event_probability import EventRow
from models.physics.billiards.cloth.closed_form_motion import duration_until_rest, evaluate_kinematics, sliding_duration

# s: how far free paths are followed beyond a contact to find their least distance.
GAP_HORIZON = 0.25
# Ball radii, about half a pixel: a ball with less left to go looks at rest. Real balls even roll back a little, into
# the dent that they make in the cloth, so that the moment of zero speed cannot be observed: a rest is reported midway
# between both, with half of the time between them as an error. Of 19 rests labelled by eye in real clips, the best
# guesses lie at nine tenths of that time (median), and one in three beyond its end.
REST_DISTANCE_RADII = 0.025
# m/s: least closing speed of two balls that meet; slower than any ball that can be distinguished from a resting one.
_MIN_CLOSING_SPEED = 0.02
# s: a less certain rest is no event.
_MAX_TIME_SIGMA = 0.5
# m/s: at this closing speed a ball that turns beside another one has met it.
_CLEAR_CONTACT_SPEED = 0.3
# m: uncertainty of the place of such a contact.
_CONTACT_PLACE_SIGMA = 0.01
# Ball radii: a smaller motion of an object ball by itself is a measurement error.
NUDGE_RADII = 0.5
# Share of the time without samples around a strike: uncertainty of the strike time.
_UNOBSERVED_TIME_SHARE = 0.02


def list_events(
    solution: JointSolution,
    tracks: Tracks,
    table: Table,
    pocketed: list[EventRow],
    break_contacts: list[EventRow],
    hidden: set[int],
) -> list[EventRow]:
    """List all events of a clip, including `break_contacts`; their probabilities are not known yet.

    The contacts `hidden` are no events: frames do not show what happened there.
    """
    layout = layout_parameters(solution.graph)
    events = [*pocketed, *break_contacts]
    for number in sorted({*range(len(solution.graph.contacts))} - hidden):
        contact = solution.graph.contacts[number]
        events += _list_contact_events(solution, layout, number, contact, tracks, table)
    vanish = {event.a: event.t for event in pocketed}
    events += _find_rests(solution, layout, tracks, table.ball_radius)
    jaws = 3 * float(np.median(np.diff(tracks.t))) if pocketed else 0.0
    selected = [
        event for event in events
        if event.kind not in ("rest", "cushion") or event.t < vanish.get(event.a, np.inf) - jaws
    ]  # fmt: skip
    return [_limit_sigma(event, tracks) for event in selected]


def _limit_sigma(event: EventRow, tracks: Tracks) -> EventRow:
    """Limit the time error to a few frames: the samples before and after an event show that much."""
    times = tracks.t[tracks.is_observed[:, tracks.ids.index(event.a)]]
    row = int(np.clip(np.searchsorted(times, event.t), 1, len(times) - 1)) if len(times) > 1 else 0
    limit = 2 * float(times[row] - times[row - 1]) if row else _MAX_TIME_SIGMA
    return replace(event, t_sigma=min(event.t_sigma, limit)) if event.kind != "rest" else event


def collect_events(rows: list[EventRow], tracks: Tracks) -> Events:
    """Collect events into columns, sorted by time."""
    rows = sorted(rows, key=lambda event: (event.t, event.a))
    t = np.array([event.t for event in rows], dtype=np.float64)
    return Events(
        tuple(event.kind for event in rows), t,
        np.array([max(event.t_sigma, 1e-6) for event in rows], dtype=np.float64),
        tracks.frame_at(t),
        tuple(event.a for event in rows), tuple(event.b for event in rows),
        np.array([event.xy for event in rows]).reshape(-1, 2),
        *(np.array([getattr(event, name) for event in rows], dtype=np.float64)
          for name in ("probability", "gap", "gap_sigma", "speed")),
    )  # fmt: skip


def _list_contact_events(
    solution: JointSolution, layout: ParameterLayout, number: int, contact: Contact, tracks: Tracks, table: Table
) -> list[EventRow]:
    """List the events of one contact."""
    ids = tracks.ids
    if contact.kind in ("jump", "break"):
        return []
    if contact.kind == "free":
        return _find_unmodelled_contact(solution, layout, number, contact, tracks, table) + _list_stopped_balls(
            solution, layout, number, contact, ids
        )
    segments = solution.graph.segments
    balls = [segments[k].ball for k in contact.before]
    sigma = float(np.sqrt(solution.covariance[layout.contact + number, layout.contact + number]))
    after = [segments[k].state for k in contact.after]
    if contact.kind == "strike":
        speed = float(np.hypot(*after[0][2:4]))
        is_cue = _is_cue_ball(solution, balls[0], tracks.kinds)
        hitter = None if is_cue else _find_hitting_ball(solution, contact, tracks, table)
        if hitter is not None:
            sigma = max(sigma, 0.5 * float(np.median(np.diff(tracks.t))))
            return [
                EventRow(
                    "ball", contact.t, sigma, ids[hitter], ids[balls[0]], after[0][:2], "passing", number, speed=speed
                )
            ]
        times = tracks.t[tracks.is_observed[:, balls[0]]]
        row = int(np.clip(np.searchsorted(times, contact.t), 1, max(len(times) - 1, 1)))
        gap = float(times[row] - times[row - 1]) if len(times) > 1 else 0.0
        sigma = float(np.hypot(sigma, _UNOBSERVED_TIME_SHARE * gap))
        distance = np.linalg.norm(end_state(solution, contact.after[0])[:2] - after[0][:2])
        if not is_cue and distance < NUDGE_RADII * table.ball_radius:
            return []
        category = "strike" if is_cue else "object_strike"
        return [EventRow("strike", contact.t, sigma, ids[balls[0]], "", after[0][:2], category, number, speed=speed)]
    before = [end_state(solution, k) for k in contact.before]
    if contact.kind == "cushion":
        side = CUSHIONS.index(contact.cushion)
        gap, gap_sigma = _cushion_gap(solution, layout, contact, side, table)
        speed = float(-INWARD_NORMALS[side] @ before[0][2:4])
        events = [
            EventRow(
                "cushion",
                contact.t,
                sigma,
                ids[balls[0]],
                contact.cushion,
                after[0][:2],
                "cushion",
                number,
                gap=gap,
                gap_sigma=gap_sigma,
                speed=speed,
            )
        ]
        return events + _list_stopped_balls(solution, layout, number, contact, ids)
    separation = after[1][:2] - after[0][:2]
    normal = separation / np.hypot(*separation)
    speed = float((before[0][2:4] - before[1][2:4]) @ normal)
    if speed < _MIN_CLOSING_SPEED and not contact.driven:  # balls that lie together, or separate: no contact
        return _list_stopped_balls(solution, layout, number, contact, ids)
    gap, gap_sigma = _ball_gap(solution, layout, contact, table)
    events = [
        EventRow(
            "ball",
            contact.t,
            sigma,
            ids[balls[0]],
            ids[balls[1]],
            after[0][:2],
            "ball",
            number,
            gap=gap,
            gap_sigma=gap_sigma,
            speed=speed,
        )
    ]
    return events + _list_stopped_balls(solution, layout, number, contact, ids)


def _is_cue_ball(solution: JointSolution, ball: int, kinds: tuple[str, ...]) -> bool:
    """Return whether a ball is a cue ball: by class, or as the one that moves first.

    Where another ball looks like the cue ball, it has to set one in motion too: what does so is a ball of any class.
    """
    graph = solution.graph
    if kinds[ball] in CUE_KINDS:
        return True
    starts = [(graph.start_time(k), segment.ball) for k, segment in enumerate(graph.segments) if not segment.static]
    if min(starts)[1] != ball:
        return False
    return not any(kind in CUE_KINDS for kind in kinds) or any(
        contact.kind == "ball" and graph.segments[one].ball == ball and graph.segments[other].static
        for contact in graph.contacts if len(contact.before) == 2
        for one, other in (contact.before, contact.before[::-1])
    )  # fmt: skip


def _find_unmodelled_contact(
    solution: JointSolution, layout: ParameterLayout, number: int, contact: Contact, tracks: Tracks, table: Table
) -> list[EventRow]:
    """Find the contact with a ball that lies where another one turns, though no law explains their motion.

    This happens where a cue ball meets a rack: its momentum has gone on to the next balls before a frame shows it.
    """
    graph, ids = solution.graph, tracks.ids
    ball, incoming = graph.segments[contact.before[0]].ball, end_state(solution, contact.before[0])
    candidates: list[tuple[float, int, float]] = []
    for other in {segment.ball for segment in graph.segments} - {ball}:
        other_state = evaluate_state(graph, solution.friction, find_segment_at(graph, other, contact.t), contact.t)
        separation = other_state[:2] - incoming[:2]
        distance = float(np.hypot(*separation))
        closing = float((incoming[2:4] - other_state[2:4]) @ separation) / max(distance, 1e-9)
        mismatch = abs(distance / table.ball_radius - 2)
        if mismatch < BALL_TOLERANCE and closing > _CLEAR_CONTACT_SPEED:
            candidates.append((mismatch, other, closing))
    if not candidates:
        return []
    _, other, closing = min(candidates)
    interval = float(np.median(np.diff(tracks.t)))
    near = [c for c in graph.contacts if c.kind == "ball" and abs(c.t - contact.t) < interval]
    if any(graph.balls_at(c) == {ball, other} for c in near):  # it is in the graph already
        return []
    sigma = max(float(np.sqrt(solution.covariance[(layout.contact + number,) * 2])), _CONTACT_PLACE_SIGMA / closing)
    return [EventRow("ball", contact.t, sigma, ids[ball], ids[other], incoming[:2], "passing", number, speed=closing)]


def _find_hitting_ball(solution: JointSolution, contact: Contact, tracks: Tracks, table: Table) -> int | None:
    """Find the ball that set an object ball in motion though no common contact was fitted.

    It is a neighbour that leaves within the same frame, or a ball whose track begins just after on a path from here.
    """
    graph, interval = solution.graph, float(np.median(np.diff(tracks.t)))
    place, ball = graph.segments[contact.before[0]].state[:2], graph.segments[contact.before[0]].ball
    candidates: list[tuple[float, int]] = []
    for k, segment in enumerate(graph.segments):
        if segment.ball == ball:
            continue
        if segment.static:
            other_place = segment.state[:2]
            fits = abs(graph.end_time(k) - contact.t) < 1.5 * interval
        else:
            other_place = evaluate_kinematics(
                segment.state[None], np.array([contact.t - segment.t0]), solution.friction
            )[0, :2]
            fits = segment.start is None and 0 < segment.t0 - contact.t < 5 * interval
        mismatch = abs(float(np.linalg.norm(other_place - place)) / table.ball_radius - 2)
        if fits and mismatch < (0.35 if segment.static else 0.8):
            candidates.append((mismatch, segment.ball))
    return min(candidates)[1] if candidates else None


def _list_stopped_balls(
    solution: JointSolution, layout: ParameterLayout, number: int, contact: Contact, ids: tuple[str, ...]
) -> list[EventRow]:
    """List the balls that a contact brought to rest."""
    segments = solution.graph.segments
    sigma = float(np.sqrt(solution.covariance[layout.contact + number, layout.contact + number]))
    return [
        EventRow("rest", contact.t, sigma, ids[segments[two].ball], "", segments[two].state[:2], "rest", number)
        for one, two in zip(contact.before, contact.after, strict=True)
        if segments[two].static and not segments[one].static and sigma < _MAX_TIME_SIGMA
    ]


def _find_rests(solution: JointSolution, layout: ParameterLayout, tracks: Tracks, radius: float) -> list[EventRow]:
    """Find balls that rolled out and were observed at rest."""
    graph, events = solution.graph, []
    for k, segment in enumerate(graph.segments):
        if segment.static:
            continue
        looks_still, stop = _rollout_times(solution, k, REST_DISTANCE_RADII * radius)
        length = (looks_still + stop) / 2
        t = graph.start_time(k) + length
        times = tracks.t[tracks.is_observed[:, segment.ball]]
        if graph.start_time(k) + stop > graph.end_time(k) or t > times[-1]:
            continue
        place = evaluate_kinematics(segment.state[None], np.array([length]), solution.friction)[0, :2]
        sigma = float(np.hypot(_rest_time_sigma(solution, layout, k), (stop - looks_still) / 2))
        if sigma > _MAX_TIME_SIGMA or (
            _starts_at_rest(solution, k) and np.linalg.norm(place - segment.state[:2]) < NUDGE_RADII * radius
        ):
            continue
        events.append(EventRow("rest", t, sigma, tracks.ids[segment.ball], "", place, "rest"))
    return events


def _rollout_times(solution: JointSolution, k: int, to_go: float) -> tuple[float, float]:
    """Return s after the start of a segment: when it has `to_go` m left, and when it stops."""
    state, friction = solution.graph.segments[k].state, solution.friction
    stop, slide = float(duration_until_rest(state, friction)), float(sliding_duration(state, friction))
    speed = float(np.hypot(*evaluate_kinematics(state[None], np.array([slide]), friction)[0, 2:4]))
    last = np.sqrt(2 * to_go * (stop - slide) / max(speed, 1e-9))
    return max(stop - float(last), 0.0), stop


def _starts_at_rest(solution: JointSolution, k: int) -> bool:
    """Return whether a segment is the first of its ball, or follows a rest."""
    start, segments = solution.graph.segments[k].start, solution.graph.segments
    if start is None:
        return True
    contact = solution.graph.contacts[start]
    return segments[contact.before[contact.after.index(k)]].static


def _rest_time_sigma(solution: JointSolution, layout: ParameterLayout, k: int) -> float:
    """Return the sigma of the time of rest, s, by central differences over state and friction."""
    segment, friction, step = solution.graph.segments[k], solution.friction, 1e-6
    gradient = np.zeros(layout.size)
    for index in range(SEGMENT_STATE_SIZE):
        shift = np.zeros(SEGMENT_STATE_SIZE)
        shift[index] = step
        gradient[layout.segment[k] + index] = float(
            duration_until_rest(segment.state + shift, friction) - duration_until_rest(segment.state - shift, friction)
        ) / (2 * step)
    for index in range(2):
        up, down = (_scale_friction(friction, index, float(np.exp(sign * step))) for sign in (1, -1))
        change = float(duration_until_rest(segment.state, up) - duration_until_rest(segment.state, down))
        gradient[layout.shared + index] = change / (2 * step)
    if segment.start is not None:
        gradient[layout.contact + segment.start] = 1.0
    variance = float(gradient @ solution.covariance @ gradient)
    return float(np.sqrt(max(variance, 0.0)))


def _scale_friction(friction: ClothFriction, index: int, by: float) -> ClothFriction:
    """Multiply one coefficient, sliding (0) or rolling (1), by a factor."""
    return ClothFriction(friction.sliding * (by if index == 0 else 1.0), friction.rolling * (by if index == 1 else 1.0))


def _free_path(solution: JointSolution, k: int, t: FloatArray) -> FloatArray:
    """Return positions (M, 2) of a segment, followed beyond its end without the contact there."""
    segment = solution.graph.segments[k]
    if segment.static:
        return np.repeat(segment.state[None, :2], len(t), axis=0)
    states = np.repeat(segment.state[None], len(t), axis=0)
    return evaluate_kinematics(states, t - solution.graph.start_time(k), solution.friction)[:, :2]


def _ball_gap(solution: JointSolution, layout: ParameterLayout, contact: Contact, table: Table) -> tuple[float, float]:
    """Return the least gap of two balls on free paths, and its sigma, m."""
    t = contact.t + np.linspace(-0.02, GAP_HORIZON, 271)
    separation = _free_path(solution, contact.before[1], t) - _free_path(solution, contact.before[0], t)
    distance = np.linalg.norm(separation, axis=1)
    least = int(np.argmin(distance))
    reach = 2 * table.ball_radius * solution.diameter_factor
    normal = separation[least] / max(distance[least], 1e-9)
    variance = (2 * table.ball_radius) ** 2 * solution.covariance[layout.shared + 2, layout.shared + 2]
    for k in contact.before:
        tau = np.array([t[least] - solution.graph.start_time(k)])
        variance += float(normal @ state_covariance(solution, layout, k, tau)[0, :2, :2] @ normal)
    return float(distance[least] - reach), float(np.sqrt(variance))


def _cushion_gap(
    solution: JointSolution, layout: ParameterLayout, contact: Contact, side: int, table: Table
) -> tuple[float, float]:
    """Return the least gap of a ball and a cushion on a free path, and its sigma, m."""
    t = contact.t + np.linspace(-0.02, GAP_HORIZON, 271)
    distance = cushion_distances(_free_path(solution, contact.before[0], t), table)[:, side]
    least = int(np.argmin(distance))
    column = layout.shared + 3 + side
    tau = np.array([t[least] - solution.graph.start_time(contact.before[0])])
    place = state_covariance(solution, layout, contact.before[0], tau)[0, :2, :2]
    variance = float(INWARD_NORMALS[side] @ place @ INWARD_NORMALS[side] + solution.covariance[column, column])
    return float(distance[least] - table.ball_radius - solution.nose_offsets[side]), float(np.sqrt(variance))
