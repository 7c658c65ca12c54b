"""Views of a shot: events, trajectory, hypotheses, parameters and trust level, computed from its solution."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import CAUSELESS_KINDS, JointSolution, layout_parameters
from models.core.events import Events, merge_events
from models.core.fit_result import MIN_LISTED_PROBABILITY, Fit, Moment, Parameter, RackBreak, ShotExplanation, Trust
from models.core.naming import Naming
from models.core.number_format import format_time
from models.core.scene import POCKETS, Table
from models.core.shot import BreakExit, ClosePass, Shot, SimulatedBreak
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock, Trajectory
from models.core.typing import FloatArray
from models.estimation.hand_marks.resolved_marks import resolve_marks, weigh_marks
from models.estimation.joint_fit.fit_solution import DIAMETER_COLUMN, end_state
from models.estimation.joint_fit.pseudo_observations import ROLLING_PRIOR, SLIDING_PRIOR
from models.estimation.joint_fit.trust_level import (
    add_warnings,
    assess_noise,
    assess_trust,
    evaluate_segment_chi2,
    find_accepted_segments,
)
from models.estimation.reconstruction.event_list import collect_events, list_events
from models.estimation.reconstruction.plausibility import describe_ball_factor, warn_of_contact_ball_size
from models.estimation.reconstruction.rack_breaks import find_rack_breaks
from models.estimation.reconstruction.trajectory_assembly import (
    TrajectoryPiece,
    build_measured_pieces,
    build_pieces,
    pack_trajectory,
    shift_polynomial,
)
from models.estimation.reconstruction.unexplained_motion import mark_unexplained_motion
from models.estimation.shot_hypotheses.event_probability import EventRow, assess_premises, weigh_close_pass
from models.estimation.shot_hypotheses.weigh_hypotheses import weigh_events
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics
from models.tracking.ball_classes import find_missing_colours
from models.tracking.track_noise import NOISE_FLOOR_RADII

# Velocity changes that a warning lists.
_MAX_LISTED = 3
# Shots whose views are kept in memory: a command reads one, and compares it with few.
_KEPT_VIEWS = 4


@lru_cache(_KEPT_VIEWS)
def view_shot(shot: Shot) -> Fit:
    """Evaluate the views of a shot at presentation times.

    Returns:
        Events, trajectory, hypotheses, parameters and trust level.
    """
    fit = _convert_to_presentation_time(view_captured(shot), shot.tracks, shot.clock)
    warnings = (
        *_warn_of_unexplained_changes(fit.explanation, shot.naming), *_warn_of_missing_balls(shot),
        *shot.scene.warnings,
        *warn_of_contact_ball_size(fit.parameters, shot.scene),
    )  # fmt: skip
    trust = add_warnings(fit.trust, warnings)
    trust = replace(trust, reasons=(*trust.reasons, *_note_capture_times(shot.clock)))
    return replace(fit, trust=trust, naming=shot.naming)


def view_captured(shot: Shot) -> Fit:
    """Evaluate the views of a shot at capture times.

    Returns:
        Events, trajectory, hypotheses, parameters and trust level.
    """
    fit = _view_measured_motion(shot) if shot.solution is None else _view_solution(shot, shot.solution)
    if not len(shot.tracks.t):
        return fit
    tracks = shot.capture_tracks
    events, explanation = _add_close_passes(fit.events, fit.explanation, shot.passes, tracks)
    if shot.solution is not None and shot.corrections.contacts:
        marks, _ = resolve_marks(shot.corrections.contacts, tracks)
        events, explanation = weigh_marks(events, explanation, marks, shot.outcomes[: len(marks)], tracks)
    explanation = mark_unexplained_motion(explanation, fit.trajectory, tracks)
    return replace(fit, events=events, explanation=explanation)


def _view_solution(shot: Shot, solution: JointSolution) -> Fit:
    """View a shot that physics explains."""
    original, tracks, observations, table = shot.capture_tracks, shot.fitted_tracks, shot.observations, shot.scene.table
    is_accepted = find_accepted_segments(
        solution, observations, table.ball_radius, _pixel_size(original, table.ball_radius)
    )
    chi2, _, _ = evaluate_segment_chi2(solution, observations)
    pocketed = _find_pocketed_balls(solution, tracks, table)
    ends = {tracks.ids.index(event.a): event.t for event in pocketed}
    unfitted_balls = [
        ball
        for ball in range(len(original.ids))
        if original.is_observed[:, ball].any() and not tracks.is_observed[:, ball].any()
    ]
    unfitted_pieces = [piece for ball in unfitted_balls for piece in build_measured_pieces(original, ball)]
    clip_span = (float(tracks.t[0]), float(tracks.t[-1]))
    trajectory = pack_trajectory(
        build_pieces(solution, observations, is_accepted, len(original.ids), clip_span, table.ball_radius, ends)
        + _build_break_pieces(shot.breaks)
        + unfitted_pieces,
        original.ids,
    )
    state = trajectory.at(original.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > shot.moving_speed
    accepted = np.isfinite(state.xy[..., 0]) & ~state.measured
    seconds, explained_seconds = _sum_moving_time(original.t, moving, accepted)
    noise = assess_noise(solution, observations, is_accepted, NOISE_FLOOR_RADII * table.ball_radius)
    breaks, first_contacts = find_rack_breaks(shot, solution)
    hidden = {row.contact for row in first_contacts} | _find_hidden_contacts(solution, breaks, tracks.ids)
    changes = _sum_causeless_changes(solution, hidden, table.ball_radius, tracks.ids)
    first_contacts += _list_break_contacts(shot.breaks, tracks.ids)
    rows = [
        row for row in list_events(solution, tracks, table, pocketed, first_contacts, hidden)
        if row.kind != "rest" or not ShotExplanation(breaks=breaks).is_within_rack(row.t, row.a)
    ]  # fmt: skip
    starts = np.array([sum(row.category == "object_strike" and row.a == ball for row in rows) for ball in tracks.ids])
    premises = assess_premises(seconds, explained_seconds, changes, starts, _measure_absence(original, set(ends)))
    weighed, explanation = weigh_events(
        rows, solution, observations, tracks, table, chi2, shot.hypotheses, breaks, hidden,
        dict(zip(tracks.ids, premises, strict=True)),
    )  # fmt: skip
    weighed = [
        replace(row, gap=float(shot.gaps[row.contact, 0]), gap_sigma=float(shot.gaps[row.contact, 1]))
        if row.category == "ball" and np.isfinite(shot.gaps[row.contact, 0]) else row
        for row in weighed
    ]  # fmt: skip
    return Fit(
        collect_events(weighed, tracks),
        trajectory,
        _list_coefficients(solution),
        noise.sigma,
        noise.chi2,
        original.xy - state.xy,
        moving,
        accepted,
        assess_trust(
            float(explained_seconds.sum() / seconds.sum()) if seconds.any() else 1.0,
            noise,
            float(seconds.sum()),
            _list_warnings(solution, [shot.naming.say(original.ids[ball]) for ball in unfitted_balls]),
        ),
        explanation,
        shot.outcomes,
        chi2_range=noise.chi2_range,
    )


def _find_hidden_contacts(solution: JointSolution, breaks: tuple[RackBreak, ...], ids: tuple[str, ...]) -> set[int]:
    """Find the contacts of balls of a rack while it bursts, and the velocity changes that the break causes."""
    graph, explanation = solution.graph, ShotExplanation(breaks=breaks)
    balls = [tuple(ids[ball] for ball in graph.balls_at(contact)) for contact in graph.contacts]
    return {
        number for number, contact in enumerate(graph.contacts)
        if (contact.kind == "ball" and explanation.is_within_rack(contact.t, *balls[number]))
        or (contact.kind in CAUSELESS_KINDS and explanation.is_due_to_break(contact.t, balls[number][0]))
    }  # fmt: skip


def _convert_to_presentation_time(fit: Fit, tracks: Tracks, clock: CaptureClock) -> Fit:
    """Convert a fit from capture times to presentation times."""
    if clock.is_identity:
        return fit
    t = clock.presentation_time_at(fit.events.t)
    events = replace(
        fit.events, t=t, t_sigma=fit.events.t_sigma * clock.presentation_rate_at(fit.events.t), frame=tracks.frame_at(t)
    )
    explanation = _convert_times(fit.explanation, clock)
    outcomes = tuple(
        replace(one, t=float(clock.presentation_time_at(np.array([one.t]))[0])) for one in fit.mark_outcomes
    )
    motion = fit.trajectory
    motion = replace(
        motion, start=clock.presentation_time_at(motion.start), end=clock.presentation_time_at(motion.end), clock=clock
    )
    return replace(fit, events=events, trajectory=motion, explanation=explanation, mark_outcomes=outcomes)


def _note_capture_times(clock: CaptureClock) -> tuple[str, ...]:
    """Return a note on frames whose capture times are not their presentation times; empty without any."""
    if clock.is_identity:
        return ()
    deviation = 1e3 * np.ptp(clock.capture_time - clock.presentation_time)
    return (f"Frames were dropped, duplicated or late: their capture times deviate by up to {deviation:.0f} ms.",)


def _warn_of_unexplained_changes(explanation: ShotExplanation, naming: Naming) -> tuple[str, ...]:
    """Return a warning that names velocity changes whose most probable cause is unknown; empty without any."""
    moments = (one for one in explanation.moments if one.best.cause == "unexplained")
    unknown = list(dict.fromkeys(f"{naming.say(one.ball)} at {format_time(one.t, one.t_sigma)}" for one in moments))
    if not unknown:
        return ()
    places = ", ".join(unknown[:_MAX_LISTED])
    more = f" and {len(unknown) - _MAX_LISTED} more" if len(unknown) > _MAX_LISTED else ""
    return (f"Changed speed or direction without a known cause: {places}{more}.",)


def _warn_of_missing_balls(shot: Shot) -> tuple[str, ...]:
    """Return a warning that names balls of the set that must be on the table and were not detected."""
    missing = find_missing_colours(shot.tracks.kinds) if shot.scene.table.game == "snooker" else ()
    if not missing:
        return ()
    return (f"No {' or '.join(missing)} ball was detected, although it belongs on the table.",)


def _pixel_size(tracks: Tracks, radius: float) -> float:
    """Return the size of a pixel at the balls, root mean square per axis, m; 0 where it is unknown."""
    has_radius = tracks.is_observed & np.isfinite(tracks.radius_px) & (tracks.radius_px > 0)
    if not has_radius.any():
        return 0.0
    # the outline of a ball has the scale of the direction without foreshortening
    smallest_scale = (
        1.0 if tracks.image_jacobian is None else np.linalg.norm(tracks.image_jacobian[has_radius], -2, axis=(1, 2))
    )
    return float(np.median(radius / tracks.radius_px[has_radius] / smallest_scale))


def _list_warnings(solution: JointSolution, unfitted_balls: list[str]) -> list[str]:
    """List sentences about results that a user should not rely on."""
    warnings, graph = [], solution.graph
    if jumps := sum(contact.kind == "jump" for contact in graph.contacts):
        warnings.append(f"Paths jump at {jumps} place{'s' if jumps > 1 else ''}: frames may be missing there.")
    if unfitted_balls:
        warnings.append(f"Too few detections to be fitted: {', '.join(unfitted_balls)}.")
    return warnings


def _sum_moving_time(
    t: FloatArray, moving: NDArray[np.bool_], accepted: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return the moving time (N,) of each ball, and the part that accepted fits explain, s."""
    step = np.gradient(t) if len(t) > 1 else np.ones(len(t))
    return step @ moving, step @ (moving & accepted)


def _measure_absence(tracks: Tracks, pocketed: set[int]) -> FloatArray:
    """Measure the share (N,) of the clip before the first and after the last detection of each ball."""
    absence = np.ones(len(tracks.ids))
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if len(rows):
            last = tracks.t[-1] if ball in pocketed else tracks.t[rows[-1]]
            absence[ball] = 1 - (last - tracks.t[rows[0]]) / max(float(np.ptp(tracks.t)), 1e-9)
    return absence


def _sum_causeless_changes(
    solution: JointSolution, hidden: set[int], radius: float, ids: tuple[str, ...]
) -> FloatArray:
    """Sum the sizes of all changes (N,) of each ball that nothing known causes, outside breaks.

    The size of a change is that of the velocity relative to the faster one of before and after. Where the path jumps,
    the distance from its line before is added in ball radii, at most 1: missing frames leave it on that line.
    """
    total, graph = np.zeros(len(ids)), solution.graph
    for number, contact in enumerate(graph.contacts):
        if contact.kind in ("free", "jump") and number not in hidden:
            for one, two in zip(contact.before, contact.after, strict=True):
                before, after = end_state(solution, one), graph.segments[two].state
                speed = max(np.hypot(*before[2:4]), np.hypot(*after[2:4]), 1e-9)
                way = after[:2] - before[:2]
                along = max(float(way @ before[2:4]), 0.0) / max(float(before[2:4] @ before[2:4]), 1e-18)
                off = min(float(np.hypot(*(way - along * before[2:4]))) / radius, 1.0)
                total[graph.segments[one].ball] += np.hypot(*(after[2:4] - before[2:4])) / speed + off
    return total


def _list_coefficients(solution: JointSolution) -> tuple[Parameter, ...]:
    """List coefficients with errors; undetermined ones keep most of their prior's error."""
    first = layout_parameters(solution.graph).shared
    sigma = np.sqrt(np.diag(solution.covariance)[first:])
    friction = solution.friction
    coefficients = []
    for name, value, spread, prior in (
        ("sliding_friction.mu", friction.sliding, sigma[0], SLIDING_PRIOR[1]),
        ("rolling_resistance.mu", friction.rolling, sigma[1], ROLLING_PRIOR[1]),
    ):
        coefficients.append(Parameter(name, value, float(value * spread), "", bool(spread > 0.8 * prior)))
    return (*coefficients, describe_ball_factor(solution.diameter_factor, float(sigma[DIAMETER_COLUMN])))


def _view_measured_motion(shot: Shot) -> Fit:
    """View a shot that physics could not be fitted to: curves through the samples, without events."""
    tracks, failure = shot.capture_tracks, next((note.detail for note in shot.notes if note.code == "fit_failed"), None)
    reason = "No ball was detected." if failure is None else f"The fit failed: {failure}; paths are as measured."
    empty = np.empty(0)
    events = Events((), empty, empty, empty, (), (), np.empty((0, 2)), empty, empty, empty, empty)
    trajectory = pack_trajectory(
        [piece for ball in range(len(tracks.ids)) for piece in build_measured_pieces(tracks, ball)], tracks.ids
    )
    state = trajectory.at(tracks.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > shot.moving_speed
    never = np.zeros_like(moving)
    trust = Trust("red", (reason,)) if moving.any() else assess_trust(0.0, None, 0.0, [reason])
    return Fit(
        events, trajectory, (), float("nan"), float("nan"), tracks.xy - state.xy, moving, never, trust,
        mark_outcomes=shot.outcomes,
    )  # fmt: skip


def _convert_times(explanation: ShotExplanation, clock: CaptureClock) -> ShotExplanation:
    """Convert the capture times of moments to presentation times."""
    t = np.array([moment.t for moment in explanation.moments])
    rate = clock.presentation_rate_at(t)
    shown = clock.presentation_time_at(t)
    moments = tuple(
        replace(moment, t=float(shown[k]), t_sigma=float(moment.t_sigma * rate[k]))
        for k, moment in enumerate(explanation.moments)
    )
    breaks = []
    for one in explanation.breaks:
        rest, start, met, end = clock.presentation_time_at(np.array([one.rest, one.start, one.t, one.end])).tolist()
        breaks.append(replace(one, rest=rest, start=start, t=met, end=end))
    return replace(explanation, moments=moments, breaks=tuple(breaks))


def _add_close_passes(
    events: Events, explanation: ShotExplanation, passes: tuple[ClosePass, ...], tracks: Tracks
) -> tuple[Events, ShotExplanation]:
    """Add possible contacts of close passes to the moments, and to the events if they are probable enough."""
    moments, rows = list(explanation.moments), list[EventRow]()
    for one, two, result in ((each.one, each.other, each.result) for each in passes):
        if explanation.is_within_rack(result.t, tracks.ids[one], tracks.ids[two]):
            continue
        premise = explanation.premise_probability(tracks.ids[one], tracks.ids[two])
        hypotheses, p = weigh_close_pass(tracks.ids[two], result, premise)
        xy = np.array([np.interp(result.t, tracks.t, np.nan_to_num(tracks.xy[:, one, axis])) for axis in (0, 1)])
        moments.append(Moment(tracks.ids[one], result.t, result.t_sigma, xy, hypotheses, ("close_pass",)))
        if p >= MIN_LISTED_PROBABILITY:
            rows.append(
                EventRow(
                    "ball", result.t, result.t_sigma, tracks.ids[one], tracks.ids[two], xy, "close", probability=p,
                    gap=result.gap, gap_sigma=result.gap_sigma, speed=result.closing,
                )
            )  # fmt: skip
    explanation = replace(explanation, moments=tuple(sorted(moments, key=lambda entry: entry.t)))
    if rows:
        events = merge_events(events, collect_events(rows, tracks))
        events = replace(events, frame=tracks.frame_at(events.t))
    return events, explanation


def _list_break_contacts(breaks: tuple[SimulatedBreak, ...], ids: tuple[str, ...]) -> list[EventRow]:
    """List the contacts in breaks as events."""
    return [
        EventRow(
            "ball",
            contact.t,
            contact.t_sigma,
            ids[contact.a],
            ids[contact.b],
            contact.xy,
            "",
            probability=contact.probability,
            speed=contact.speed,
        )
        for posterior in breaks for contact in posterior.contacts
    ]  # fmt: skip


def _build_break_pieces(breaks: tuple[SimulatedBreak, ...]) -> list[TrajectoryPiece]:
    """Build the trajectories of balls in breaks from the best simulations."""
    pieces = []
    for posterior in breaks:
        for ball_exit in posterior.exits:
            number = posterior.balls.index(ball_exit.ball)
            pieces += _build_ball_pieces(posterior.motion, number, ball_exit, posterior.start)
    return pieces


def _build_ball_pieces(
    motion: Trajectory, number: int, ball_exit: BreakExit, break_start: float
) -> list[TrajectoryPiece]:
    """Build the trajectory of one ball of a break that starts at `break_start`, s: first to last contact."""
    pieces = []
    covariance = ball_exit.covariance[:4, :4]
    for k in np.flatnonzero(motion.ball == number):
        start, end = (
            max(float(motion.start[k]) + break_start, ball_exit.start),
            min(float(motion.end[k]) + break_start, ball_exit.end),
        )
        if end - start < 1e-9:
            continue
        offset = start - break_start - float(motion.start[k])
        position = shift_polynomial(motion.position[k], offset)
        spin = np.array([motion.spin[k, 0] + offset * motion.spin[k, 1], motion.spin[k, 1]])
        pieces.append(TrajectoryPiece(ball_exit.ball, start, end, position, spin, motion.phase[k], covariance))
    return pieces


# Ball radii, plus the way of two frames: a track that ends so near to a pocket has been potted.
POCKET_REACH = 3.0
# Ball radii from a pocket within which a falling ball is still detected: its mouth, and the way by which a ball below
# the plane of the balls seems to be aside.
SEEN_FALL_RADII = 2.0
# Frames before the last detection in which a ball may have begun to fall, and after it in which its path may lead into
# the pocket: a ball that stays longer hangs in the jaws.
FALL_FRAMES = 8


def _find_pocketed_balls(solution: JointSolution, tracks: Tracks, table: Table) -> list[EventRow]:
    """Find balls whose tracks end early, in motion, near a pocket."""
    events = []
    last_frame = len(tracks.t) - 1
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if not table.pockets or len(rows) < 2 or rows[-1] > last_frame - 2:
            continue
        segment = solution.graph.segments_of_ball(ball)[-1]
        if solution.graph.segments[segment].static:
            seen_last = _find_fall_from_jaws(solution, tracks, table, ball, segment, rows)
        else:
            seen_last = _find_fall(solution, tracks, table, ball, segment, int(rows[-1]))
        row = _find_approach(tracks, table, ball, rows)
        before = [k for k in solution.graph.segments_of_ball(ball) if solution.graph.start_time(k) <= tracks.t[row]]
        # where a ball is seen to fall, its path into the mouth counts, not that of what is seen of it there
        if seen_last and before and row < rows[-1] and not solution.graph.segments[before[-1]].static:
            seen_last = _find_fall(solution, tracks, table, ball, before[-1], row) or seen_last
        events += seen_last
    return events


def _find_approach(tracks: Tracks, table: Table, ball: int, rows: NDArray[np.int64]) -> int:
    """Find the last frame before those in which a ball is seen in the mouth of a pocket; else its last frame."""
    rows = rows[-FALL_FRAMES:]
    gap = np.linalg.norm(tracks.xy[rows, ball, None] - table.pocket_centres, axis=2)
    outside = np.flatnonzero(gap[:, int(np.argmin(gap[-1]))] > SEEN_FALL_RADII * table.ball_radius)
    return int(rows[outside[-1] if len(outside) else -1])


def _find_fall_from_jaws(
    solution: JointSolution, tracks: Tracks, table: Table, ball: int, segment: int, rows: NDArray[np.int64]
) -> list[EventRow]:
    """Find the fall of a ball that stops in the jaws for up to three frames, then is gone."""
    graph, interval = solution.graph, float(np.median(np.diff(tracks.t)))
    last = float(tracks.t[rows[-1]])
    distance = np.linalg.norm(table.pocket_centres - tracks.xy[rows[-1], ball], axis=1)
    pocket = int(np.argmin(distance))
    waited = last - graph.start_time(segment)
    if (
        graph.segments[segment].start is None
        or waited > 3 * interval
        or distance[pocket] > POCKET_REACH * table.ball_radius
    ):
        return []
    x = tracks.xy[rows[-1], ball]
    return [EventRow("pocket", last + 0.5 * interval, interval, tracks.ids[ball], POCKETS[pocket], x, "vanish")]


def _find_fall(
    solution: JointSolution, tracks: Tracks, table: Table, ball: int, segment: int, row: int
) -> list[EventRow]:
    """Find the fall of a ball whose path leads into a pocket."""
    graph, interval = solution.graph, float(np.median(np.diff(tracks.t)))
    state, begin = graph.segments[segment].state, graph.start_time(segment)
    t = max(float(tracks.t[row]), begin) + np.linspace(0, FALL_FRAMES * interval, 161)
    path = evaluate_kinematics(np.repeat(state[None], len(t), axis=0), t - begin, solution.friction)
    speed = float(np.hypot(*path[0, 2:4]))
    distance = np.linalg.norm(path[:, None, :2] - table.pocket_centres, axis=2)  # (161, 6)
    pocket = int(np.argmin(distance.min(axis=0)))
    here = float(np.linalg.norm(tracks.xy[row, ball] - table.pocket_centres[pocket]))
    reach = POCKET_REACH * table.ball_radius
    if here > reach + 2 * interval * speed or distance[:, pocket].min() > reach or speed < 0.02:
        return []
    inside = np.flatnonzero(distance[:, pocket] < max(1.0 * table.ball_radius, distance[:, pocket].min() + 1e-4))
    when = float(t[inside[0]])
    sigma = max(0.5 * interval, 0.5 * table.ball_radius / max(speed, 0.05))
    return [
        EventRow("pocket", when, sigma, tracks.ids[ball], POCKETS[pocket], path[inside[0], :2], "fall", speed=speed)
    ]  # fmt: skip
