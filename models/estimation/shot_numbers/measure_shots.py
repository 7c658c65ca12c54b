"""Numbers of all shots of a clip, from its fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.capture_clock import CaptureClock
from models.core.events import Events
from models.core.fit_result import Fit, WholeShotSolution
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.core.shot_numbers import ShotNumber, ShotNumbers, SpinState
from models.core.tracks import Tracks
from models.estimation.forecast.solution_state import (
    collect_captured_observations,
    estimate_lack_of_fit,
    inflate_covariance,
)
from models.estimation.shot_numbers.contact_numbers import classify_spin, measure_contact, simulate_contact
from models.estimation.shot_numbers.path_numbers import count_cushions, measure_length
from models.estimation.shot_numbers.pocket_numbers import measure_pocket
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.estimation.shot_numbers.shot_course import ShotCourse, list_shot_courses
from models.estimation.shot_numbers.slip_profile import profile_slip
from models.estimation.shot_numbers.strike_numbers import (
    measure_strike,
    measure_strike_of_samples,
    replace_strike,
)
from models.estimation.shot_numbers.struck_samples import rewind_samples
from models.physics.billiards.parameter_vector import SLIDING_MU

MIN_PROBABILITY = 0.5
"""Probability from which an event counts as having happened."""
SAME_STRIKE = 0.1
"""s between a strike and the start of a whole shot, at most."""


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
    cue = tracks.kinds.index("cue") if "cue" in tracks.kinds else None
    shots = []
    for course in list_shot_courses(solution.graph, cue):
        shot = _measure_shot(course, view, fit, tracks, table)
        shots.append(_refine_strike(shot, course, view, observations, factor, fit))
    return tuple(shots)


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
    clock, ids, meeting = fit.trajectory.clock, tracks.ids, course.meeting
    begin, end = present_time(course.begin, clock), present_time(course.end, clock)
    cue, first = ids[course.cue], ""
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
            contact = simulate_contact(whole, table, later, cue, first)
        if contact is None:
            contact = _require_explained(measure_contact(view, meeting, cue, first), view, fit, around)
        spin, chances = classify_spin(next(one for one in contact if one.name == "contact_spin_share"))
        numbers += contact
    potted = _list_potted(fit.events, begin, end)
    if table.pockets:
        for ball, segment, pocket in _list_pocket_paths(course, ids, potted):
            passage = measure_pocket(view, segment, ids[ball], table, pocket)
            numbers += _require_explained(passage, view, fit, (segment,))
    for ball, segments in course.segments.items():
        until = min(course.end, _last_time(tracks, ball, clock))
        length = measure_length(view, segments, until, ids[ball])
        numbers += _require_explained([length], view, fit, segments)
        numbers.append(count_cushions(fit.events, ids[ball], begin, end))
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


def _last_time(tracks: Tracks, ball: int, clock: CaptureClock | None) -> float:
    """Return the capture time, s, of the last observation of a ball."""
    shown = float(tracks.t[np.flatnonzero(tracks.is_observed[:, ball])[-1]])
    return shown if clock is None else float(clock.capture_time_at(np.array(shown)))


def select_whole_shot(whole: WholeShotSolution | None, cue: str, begin: float) -> WholeShotSolution | None:
    """Select the fit of the whole shot if it begins with a strike.

    Args:
        whole: The fit; None if there is none.
        cue: Id of the struck ball.
        begin: s, presentation time of the strike.

    Returns:
        The fit; None if it begins elsewhere, or has no samples.
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
