"""Numbers of all shots of a clip, and of their first contact of the cue ball with another ball, from its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import erf, sqrt

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import JointSolution, Observations, layout_parameters
from models.core.events import Events
from models.core.fit_result import SAME_STRIKE, SPIN_STATES, Fit, ShotNumber, ShotNumbers, SpinState, WholeShotSolution
from models.core.scene import POCKETS, Table
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock, Trajectory
from models.core.typing import FloatArray
from models.estimation.forecast.solution_state import (
    collect_captured_observations,
    estimate_lack_of_fit,
    inflate_covariance,
)
from models.estimation.joint_fit.pseudo_observations import STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import LinearState, PosteriorView, turn_angle
from models.estimation.shot_numbers.shot_course import FirstMeeting, ShotCourse, list_shot_courses
from models.estimation.shot_numbers.strike_numbers import (
    list_numbers,
    measure_strike,
    measure_strike_of_samples,
    profile_slip,
    replace_strike,
    rewind_samples,
    rolling_share,
)
from models.physics.billiards.cloth.closed_form_motion import (
    duration_until_rest,
    evaluate_kinematics,
    sliding_duration,
)
from models.physics.billiards.cushion_geometry import MouthLine, find_mouth_line
from models.physics.billiards.parameter_vector import SLIDING_MU
from models.physics.billiards.simulation.event_engine import BALL, EVENT_FIRST, EVENT_KIND, EVENT_SECOND, EVENT_TIME
from models.physics.billiards.simulation.parametrised_shot import ContactModels, convert_to_starts, simulate_start
from models.physics.billiards.simulation.simulated_shot import SimulatedShot

# Probability from which an event counts as having happened.
MIN_PROBABILITY = 0.5
# Gauss-Legendre nodes of a segment: exact to micrometres on a path of two smooth parts.
_NODES = 24
# Ball radii: a ball that passes farther from the middle of a mouth, three balls, was not sent there.
MAX_MISS_RADII = 6.0
# Times at which a segment is searched for the moment at which it passes a mouth: 1 cm of a fast ball.
_SAMPLES = 400
# s of a segment that is searched: balls roll no longer.
_LONGEST_SEARCH = 12.0


def add_shot_numbers(fit: Fit, solution: JointSolution | None, tracks: Tracks, table: Table) -> Fit:
    """Add the numbers of all shots of a clip to its fit, and give its strikes the speeds that they state.

    Args:
        fit: Fit of the clip, with the fit of whole shots where there is one.
        solution: Joint fit behind it, with covariance; None if there is none.
        tracks: Tracks of T frames and N balls.
        table: Dimensions of the table.

    Returns:
        The fit with them; as it is without a joint fit.
    """
    if solution is None:
        return fit
    numbers = measure_shots(fit, solution, tracks, table)
    return replace(fit, shot_numbers=numbers, events=state_strike_speeds(fit.events, numbers))


def state_strike_speeds(events: Events, shots: Sequence[ShotNumbers]) -> Events:
    """Give each strike the speed that the numbers of its shot state: the posterior mean, not the most probable one.

    Args:
        events: Events of the clip.
        shots: Numbers of its shots.

    Returns:
        The events with these speeds.
    """
    speed = events.speed.copy()
    for shot in shots:
        own = [kind == "strike" and ball == shot.cue for kind, ball in zip(events.kind, events.a, strict=True)]
        number = shot.find_number("cue_speed")
        if number is not None and number.observable:
            speed[np.array(own, bool) & (np.abs(events.t - shot.t) < SAME_STRIKE)] = number.value
    return replace(events, speed=speed)


def measure_shots(fit: Fit, solution: JointSolution, tracks: Tracks, table: Table) -> tuple[ShotNumbers, ...]:
    """Measure the numbers of all shots of a clip.

    Args:
        fit: Fit of the clip, with the fit of whole shots where there is one.
        solution: Joint fit behind it, with covariance.
        tracks: Tracks of T frames and N balls.
        table: Dimensions of the table.

    Returns:
        Numbers per shot, by time.
    """
    observations = collect_captured_observations(tracks, fit.trajectory.clock, table)
    factor = estimate_lack_of_fit(solution, observations)
    radius = table.ball_radius * solution.diameter_factor
    view = PosteriorView(solution, inflate_covariance(solution, factor), radius)
    shots = []
    for course in list_shots(fit, solution, tracks):
        shot = _measure_shot(course, view, fit, tracks, table)
        shots.append(_refine_strike(shot, course, view, observations, factor, fit))
    return tuple(shots)


def list_shots(fit: Fit, solution: JointSolution, tracks: Tracks) -> tuple[ShotCourse, ...]:
    """List the shots of a clip by their strokes: a ball of a rack that bursts was not struck.

    Args:
        fit: Fit of the clip.
        solution: Joint fit behind it.
        tracks: Tracks of N balls.

    Returns:
        Shots by time. None where nothing moves.
    """
    cue = tracks.kinds.index("cue") if "cue" in tracks.kinds else None
    moving = [tracks.ids.index(name) for name in fit.explanation.moving_at_start]
    return list_shot_courses(solution.graph, cue, partial(_is_stroke, fit, tracks.ids), moving)


def _is_stroke(fit: Fit, ids: tuple[str, ...], ball: int, t: float) -> bool:
    """Return whether a ball was struck at a capture time t, s, by the events."""
    events, shown = fit.events, present_time(t, fit.trajectory.clock)
    return any(
        (events.kind[k], events.a[k]) == ("strike", ids[ball])
        and events.probability[k] >= MIN_PROBABILITY
        and abs(events.t[k] - shown) < SAME_STRIKE
        for k in range(len(events))
    )


def _refine_strike(
    shot: ShotNumbers, course: ShotCourse, view: PosteriorView, observations: Observations, factor: float, fit: Fit
) -> ShotNumbers:
    """Replace speed and top spin by those of their profile, where the ball rolls before its first contact."""
    if not course.is_struck:
        return shot
    whole, friction = select_whole_shot(fit.whole_shot, shot.cue, shot.t), view.friction
    if whole is not None:
        values = np.log(whole.parameter_samples[:, SLIDING_MU])
        friction = float(np.exp(values.mean())), float(values.std(ddof=1))
    profile = profile_slip(view, observations, course.segments[course.cue][0], factor, friction)
    return shot if profile is None else replace(shot, numbers=replace_strike(shot.numbers, profile, view.radius))


def _measure_shot(course: ShotCourse, view: PosteriorView, fit: Fit, tracks: Tracks, table: Table) -> ShotNumbers:
    clock, ids = fit.trajectory.clock, tracks.ids
    begin, end = present_time(course.begin, clock), present_time(course.end, clock)
    cue, first = ids[course.cue], ""
    for one in fit.explanation.breaks:
        if one.ball == cue and begin <= one.t < end:  # the laws of a contact of two balls do not hold in a rack
            course, first = replace(course, meeting=None), _find_first_ball(fit.events, cue, begin)
    meeting = course.meeting
    chances: tuple[float, ...] = ()
    spin: SpinState = "unknown"
    whole = select_whole_shot(fit.whole_shot, cue, begin) if course.is_struck else None
    if whole is None:
        numbers = measure_strike(view, course, cue)
        numbers = _require_explained(numbers, view, fit, course.segments[course.cue][:1])
    else:
        sigma = view.strike_sigma(course.segments[course.cue][0])
        samples = rewind_samples(whole, cue, begin, sigma, table.ball_radius)
        numbers = measure_strike_of_samples(samples, whole.ids.index(cue), table.ball_radius, cue)
    if meeting is not None:
        first, around = ids[meeting.other], (meeting.cue_before, meeting.cue_after, meeting.other_after)
        contact = None
        if whole is not None and first in whole.ids:
            later = view.solution.graph.contacts[meeting.contact].t - course.begin
            contact = _simulate_contact(whole, table, later, cue, first)
        if contact is None:
            contact = _require_explained(_measure_contact(view, meeting, cue, first), view, fit, around)
        spin, chances = classify_spin(next(one for one in contact if one.name == "contact_spin_share"))
        numbers += contact
    potted = _list_potted(fit.events, begin, end)
    if table.pockets:
        for ball, segment, pocket in _list_pocket_paths(course, ids, potted):
            passage = _measure_pocket(view, segment, ids[ball], table, pocket)
            numbers += _require_explained(passage, view, fit, (segment,))
    for ball, segments in course.segments.items():
        until = min(course.end, _last_time(fit.trajectory, ball))
        length = _measure_length(view, segments, until, ids[ball])
        numbers += _require_explained([length], view, fit, segments)
        numbers.append(_count_cushions(fit.events, ids[ball], begin, end))
    return ShotNumbers(begin, cue, first, spin, chances, tuple(potted), tuple(potted.values()), tuple(numbers))


def present_time(t: float, clock: CaptureClock | None) -> float:
    """Convert a capture time to a presentation time.

    Args:
        t: s, infinite for the end of the clip.
        clock: Clock of the clip; None where both times are equal.

    Returns:
        The presentation time, s.
    """
    return t if clock is None or not np.isfinite(t) else float(clock.presentation_time_at(np.array(t)))


def _last_time(trajectory: Trajectory, ball: int) -> float:
    """Return the capture time, s, at which the trajectory of a ball ends: in a pocket after its last observation."""
    shown, clock = trajectory.end[trajectory.ball == ball].max(initial=0.0), trajectory.clock
    return float(shown if clock is None else clock.capture_time_at(np.array(shown)))


def select_whole_shot(whole: WholeShotSolution | None, cue: str, begin: float) -> WholeShotSolution | None:
    """Select the fit of the whole shot if it begins with a strike.

    Args:
        whole: The fit; None if there is none.
        cue: Id of the struck ball.
        begin: s, presentation time of the strike.

    Returns:
        The fit; None if there is none, it does not begin with this strike, or it has no samples of its posterior.
    """
    if whole is None or not len(whole.start_samples) or cue not in whole.ids:
        return None
    return whole if abs(whole.t - begin) < SAME_STRIKE else None


def _require_explained(
    numbers: list[ShotNumber], view: PosteriorView, fit: Fit, segments: tuple[int, ...]
) -> list[ShotNumber]:
    """Mark numbers as not observable where physics explains one of their segments insufficiently."""
    graph, clock = view.solution.graph, fit.trajectory.clock
    shown = np.array(fit.trajectory.end.max())
    last = float(shown if clock is None else clock.capture_time_at(shown))
    for k in segments:
        begin = graph.start_time(k)
        middle = present_time((begin + min(view.end_time(k), max(last, begin))) / 2, clock)
        if fit.trajectory.at(middle).measured[graph.segments[k].ball]:
            return [replace(one, observable=False) for one in numbers]
    return numbers


def _find_first_ball(events: Events, cue: str, begin: float) -> str:
    """Find the first ball that the cue ball touches from `begin`, s, on; empty if it touches none."""
    contacts = (
        {events.a[k], events.b[k]} - {cue}
        for k in range(len(events))
        if events.kind[k] == "ball" and events.t[k] >= begin and events.probability[k] >= MIN_PROBABILITY
        and cue in (events.a[k], events.b[k])
    )  # fmt: skip
    return next(contacts, {""}).pop()


def _list_potted(events: Events, begin: float, end: float) -> dict[str, str]:
    """List the balls that were potted in a time, with their pockets."""
    return {
        events.a[k]: events.b[k]
        for k in range(len(events))
        if events.kind[k] == "pocket" and events.probability[k] >= MIN_PROBABILITY and begin <= events.t[k] < end
    }


def _list_pocket_paths(
    course: ShotCourse, ids: tuple[str, ...], potted: dict[str, str]
) -> list[tuple[int, int, str | None]]:
    """List ball, segment and pocket of the paths into pockets, and of the object ball's path where it was missed."""
    paths: list[tuple[int, int, str | None]] = [
        (ball, segments[-1], potted[ids[ball]]) for ball, segments in course.segments.items() if ids[ball] in potted
    ]
    meeting = course.meeting
    if meeting is not None and ids[meeting.other] not in potted:
        paths.append((meeting.other, meeting.other_after, None))
    return paths


def _measure_length(view: PosteriorView, segments: tuple[int, ...], until: float, ball: str) -> ShotNumber:
    """Measure the length of the path of a ball on its moving segments, in the order of time, until a time in s."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    length, gradient = 0.0, np.zeros(len(view.covariance))
    graph, first_contact = view.solution.graph, layout_parameters(view.solution.graph).contact
    for k in segments:
        begin = graph.start_time(k)
        rest = begin + float(duration_until_rest(graph.segments[k].state[None], view.solution.friction)[0])
        end = min(view.end_time(k), until, rest)
        if end <= begin:
            continue
        for node, weight in zip(nodes, weights, strict=True):
            state = view.state_at(k, begin + (end - begin) * (node + 1) / 2)
            speed = max(float(np.hypot(*state.value[2:4])), 1e-9)
            share = weight * (end - begin) / 2
            length += share * speed
            gradient += share * (state.value[2:4] / speed) @ state.jacobian[2:4]
        for side, contact in ((-1.0, graph.segments[k].start), (1.0, graph.segments[k].end)):
            if contact is not None and (side < 0 or end == view.end_time(k)):
                state = view.state_at_start(k) if side < 0 else view.state_at_end(k)
                gradient[first_contact + contact] += side * float(np.hypot(*state.value[2:4]))
    return ShotNumber("length", float(length), view.sigma_of(gradient), "m", True, ball)


def _count_cushions(events: Events, ball: str, begin: float, end: float) -> ShotNumber:
    """Count the cushions that a ball touches between two presentation times, each weighted by its probability."""
    p = np.array(
        [
            events.probability[k]
            for k in range(len(events))
            if events.kind[k] == "cushion" and events.a[k] == ball and begin <= events.t[k] < end
        ]
    )
    return ShotNumber("cushions", float(p.sum()), float(np.sqrt((p * (1 - p)).sum())), "", True, ball)


def _measure_pocket(view: PosteriorView, segment: int, ball: str, table: Table, pocket: str | None) -> list[ShotNumber]:
    """Measure offset and speed of a ball where it passes the mouth of a pocket; nothing if it leads to no pocket.

    A path that ends at a cushion beside the mouth is continued straight. Without a name, the pocket is the one that the
    path comes nearest to. The offset from the centre line is in mm, > 0 to the right of the player.
    """
    names = POCKETS if pocket is None else (pocket,)
    passages = []
    for name in names:
        mouth = find_mouth_line(table, name)
        state = _find_passage(view, segment, mouth)
        if state is None:
            continue
        passages.append((name, *view.evaluate(partial(_measure_at_mouth, mouth=mouth), state)))
    if not passages:
        return []
    name, (offset, speed), (offset_sigma, speed_sigma) = min(passages, key=lambda one: abs(float(one[1][0])))
    if pocket is None and abs(offset) > MAX_MISS_RADII * table.ball_radius:
        return []
    return [
        ShotNumber("pocket_offset", 1e3 * float(offset), 1e3 * float(offset_sigma), "mm", True, ball, name),
        ShotNumber("pocket_speed", float(speed), float(speed_sigma), "m/s", True, ball, name),
    ]


def _find_passage(view: PosteriorView, segment: int, mouth: MouthLine) -> LinearState | None:
    """Find the state of a segment where it passes the line of a mouth, or at its end; None if it goes elsewhere."""
    graph = view.solution.graph
    begin = graph.start_time(segment)
    last = min(view.end_time(segment), begin + _LONGEST_SEARCH) - begin
    tau = np.linspace(0.0, last, _SAMPLES)
    path = evaluate_kinematics(
        np.repeat(graph.segments[segment].state[None], _SAMPLES, axis=0), tau, view.solution.friction
    )
    depth = (path[:, :2] - mouth.middle) @ mouth.outward
    crossing = np.flatnonzero((depth[:-1] < 0) & (depth[1:] >= 0))
    if len(crossing):
        return view.state_at(segment, begin + float(tau[crossing[0]]))
    end = view.state_at(segment, begin + float(tau[-1]))
    heading = float(end.value[2:4] @ mouth.outward)
    is_coming = heading > 0.1 * float(np.hypot(*end.value[2:4])) and depth[-1] < 0 and np.hypot(*end.value[2:4]) > 0
    return end if is_coming else None


def _measure_at_mouth(state: FloatArray, mouth: MouthLine) -> FloatArray:
    """Return where the straight continuation of a state passes a mouth, m right of its middle, and the speed."""
    place, velocity = state[:2] - mouth.middle, state[2:4]
    ahead = -float(place @ mouth.outward) / float(velocity @ mouth.outward)
    right = np.array([-mouth.outward[1], mouth.outward[0]])
    return np.array([(place + ahead * velocity) @ right, np.hypot(*velocity)])


# Shares of rolling spin between the states. A tenth of the rolling spin turns the final path of the cue ball by less
# than 5 degrees in a half-ball hit, which players take for the tangent line, or for natural roll.
STATE_LIMITS = (-0.1, 0.1, 0.9)
# Degrees, prior standard deviation of throw: friction 0.06 of clean balls.
THROW_SIGMA = 3.4
# m/s: below it, a direction after a contact is not observable.
MIN_SPEED = 0.05
# Names and units, in the order of `evaluate_contact`.
CONTACT_NUMBERS = (
    ("contact_speed", "m/s"), ("contact_spin_share", ""), ("cut_angle", "deg"), ("throw", "deg"),
    ("object_speed", "m/s"), ("deflection", "deg"),
)  # fmt: skip
# s after the contact that a simulation lasts: every ball rolls by then.
_VIEW_AFTER = 1.0
# s before and after a contact at which its states are taken: a fast ball moves a micrometre in it.
_INSTANT = 1e-7
# Share of the posterior samples that must meet the ball that was met; else the contact is too thin for them.
_MIN_AGREEMENT = 0.95


def _measure_contact(view: PosteriorView, meeting: FirstMeeting, cue: str, other: str) -> list[ShotNumber]:
    """Measure spin, cut angle, throw, speeds and deflection at the first contact from the paths around it.

    Args:
        view: Joint fit with its covariance.
        meeting: The contact.
        cue: Id of the struck ball.
        other: Id of the ball that it hits.

    Returns:
        The numbers. Angles turn to the right of the player where they are positive.
    """
    graph, k = view.solution.graph, meeting.cue_after
    rolls = graph.start_time(k) + float(sliding_duration(graph.segments[k].state[None], view.solution.friction)[0])
    values, sigmas = view.evaluate(
        lambda x: evaluate_contact(x.reshape(5, 6)),
        view.state_at_end(meeting.cue_before),
        view.state_at_end(meeting.other_before),
        view.state_at_start(k),
        view.state_at_start(meeting.other_after),
        view.state_at_end(k) if rolls >= view.end_time(k) else view.state_at(k, rolls),
    )
    leaves = float(np.hypot(*view.state_at_start(k).value[2:4])) > MIN_SPEED
    return _list_contact(values, sigmas, cue, other, leaves)


def _simulate_contact(
    whole: WholeShotSolution, table: Table, seconds: float, cue: str, other: str
) -> list[ShotNumber] | None:
    """Measure the same numbers from posterior samples of a fit of the whole shot, which also knows both friction laws.

    Args:
        whole: The fit.
        table: Dimensions of the table.
        seconds: s from its start to the contact.
        cue: Id of the struck ball.
        other: Id of the ball that it hits.

    Returns:
        The numbers; None if there are no samples, or too many of them miss the ball.
    """
    pair = whole.ids.index(cue), whole.ids.index(other)
    rows = []
    samples = zip(whole.start_samples, whole.parameter_samples, whole.sample_ball_models, strict=True)
    for start, values, ball_model in samples:
        laws = ContactModels(whole.cushion_model, ball_model)
        try:
            shot = simulate_start(start, whole.moving, table, values, laws, seconds + _VIEW_AFTER)
        except ArithmeticError:  # balls that meet without end: no shot
            continue
        states = _states_of_contact(shot, *pair, float(values[SLIDING_MU]))
        if states is not None:
            rows.append(evaluate_contact(states))
    if not rows or len(rows) < _MIN_AGREEMENT * len(whole.start_samples):
        return None
    numbers = np.array(rows)
    middle = np.median(numbers, axis=0)
    angles = [k for k, (_, unit) in enumerate(CONTACT_NUMBERS) if unit == "deg"]
    numbers[:, angles] = middle[angles] + (numbers[:, angles] - middle[angles] + 180.0) % 360.0 - 180.0
    return _list_contact(numbers.mean(axis=0), numbers.std(axis=0, ddof=1), cue, other, True)


def classify_spin(share: ShotNumber) -> tuple[SpinState, tuple[float, ...]]:
    """Classify the spin of the cue ball at its first contact.

    Args:
        share: Its share of rolling spin.

    Returns:
        The most probable state, and the probabilities (4,) of `SPIN_STATES`.
    """
    below = [0.5 * (1 + erf((limit - share.value) / max(share.sigma, 1e-9) / sqrt(2))) for limit in STATE_LIMITS]
    probabilities = np.diff([0.0, *below, 1.0])
    state = SPIN_STATES[int(np.argmax(probabilities))] if share.observable else "unknown"
    return state, tuple(float(p) for p in probabilities)


def evaluate_contact(states: FloatArray) -> FloatArray:
    """Evaluate the numbers of a contact.

    Args:
        states: (5, 6) place, velocity and slip: of the cue ball and the other ball before the contact, of both after
            it, and of the cue ball when it rolls.

    Returns:
        (6,) in the order of `CONTACT_NUMBERS`.
    """
    before, other_before, after, other_after, rolling = states
    line = other_after[:2] - after[:2]
    return np.array(
        [
            np.hypot(*before[2:4]),
            rolling_share(before),
            turn_angle(before[2:4] - other_before[2:4], line),
            turn_angle(line, other_after[2:4] - other_before[2:4]),
            np.hypot(*other_after[2:4]),
            turn_angle(before[2:4], rolling[2:4]),
        ]
    )


def _list_contact(values: FloatArray, sigmas: FloatArray, cue: str, other: str, leaves: bool) -> list[ShotNumber]:
    """List the numbers of a contact, in the order of `CONTACT_NUMBERS`."""
    is_observable = (
        True, sigmas[1] < PRIOR_DOMINATED * STRUCK_SLIP, values[0] > MIN_SPEED,
        sigmas[3] < PRIOR_DOMINATED * THROW_SIGMA, True, leaves,
    )  # fmt: skip
    return list_numbers(CONTACT_NUMBERS, values, sigmas, is_observable, (cue, cue, other, other, other, cue))


def _states_of_contact(shot: SimulatedShot, cue: int, other: int, friction: float) -> FloatArray | None:
    """Return the states (5, 6) around the first contact of the cue ball with a ball; None if it is another ball."""
    own = shot.contacts[(shot.contacts[:, [EVENT_FIRST, EVENT_SECOND]] == cue).any(axis=1)]
    own = own[(own[:, EVENT_KIND] == BALL) | (own[:, EVENT_FIRST] == cue)]
    met = np.flatnonzero(own[:, EVENT_KIND] == BALL)
    if not len(met) or {int(own[met[0], EVENT_FIRST]), int(own[met[0], EVENT_SECOND])} != {cue, other}:
        return None
    t = float(own[met[0], EVENT_TIME])
    later = own[own[:, EVENT_TIME] > t + 2 * _INSTANT, EVENT_TIME]
    next_contact = float(later[0]) if len(later) else shot.seconds

    def states(time: float) -> FloatArray:
        return convert_to_starts(shot.states_at(time), shot.balls.radius)[[cue, other], :6]

    before, after = states(t - _INSTANT), states(t + _INSTANT)
    slide = 2 / 7 * float(np.hypot(*after[0, 4:6])) / (friction * GRAVITY)
    return np.vstack([before, after, states(min(t + slide, next_contact - _INSTANT))[:1]])
