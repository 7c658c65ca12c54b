"""Fit of a shot: tracks in, events and motion between frames out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.by_hand.corrections import ContactCorrection
from models.core.capture_clock import CaptureClock
from models.core.contact_graph import ContactGraph
from models.core.events import Events
from models.core.fit_result import Fit, Parameter, Trust
from models.core.joint_solution import JointSolution, Observations, layout_parameters
from models.core.options import FitOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene, Table
from models.core.shot_explanation import MarkOutcome, ShotExplanation
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.break_shot.break_posterior import BreakPosterior
from models.estimation.contact_test.candidate_contacts import find_close_passes
from models.estimation.contact_test.shot_record import make_shot_record
from models.estimation.hand_marks.event_marks import weigh_marks
from models.estimation.hand_marks.graph_marks import MarkedFit, apply_marks, condition_on_marks, settle_marks
from models.estimation.hand_marks.resolved_marks import ResolvedMark, resolve_marks
from models.estimation.joint_fit.fit_arrays import DIAMETER_COLUMN
from models.estimation.joint_fit.fit_solution import assign_observations, collect_observations, evaluate_residuals
from models.estimation.joint_fit.joint_refinement import add_covariance, refine_graph
from models.estimation.joint_fit.prior_residuals import ROLLING_PRIOR, SLIDING_PRIOR
from models.estimation.joint_fit.trust_level import (
    add_warnings,
    assess_trust,
    evaluate_segment_chi2,
    find_accepted_segments,
)
from models.estimation.reconstruction.break_refinement import (
    build_break_pieces,
    list_break_contacts,
    reconstruct_breaks,
    select_outside_breaks,
)
from models.estimation.reconstruction.capture_times import estimate_capture_times
from models.estimation.reconstruction.contact_ball_size import describe_ball_factor, warn_of_contact_ball_size
from models.estimation.reconstruction.contact_time_refinement import refine_contact_times
from models.estimation.reconstruction.event_list import collect_events, frame_at, list_events
from models.estimation.reconstruction.noise_reestimation import reestimate_noise
from models.estimation.reconstruction.pocket_events import find_pocketed_balls
from models.estimation.reconstruction.shot_moments import add_close_passes, align_moments, convert_times
from models.estimation.reconstruction.trajectory_assembly import build_measured_pieces, build_pieces, pack_trajectory
from models.estimation.reconstruction.unexplained_motion import mark_unexplained_motion
from models.estimation.segmentation.contact_classification import build_contact_graph, find_contact_opportunities
from models.estimation.segmentation.jitter_removal import extend_rest_until_hit, remove_jitter
from models.estimation.segmentation.track_segmentation import BallSamples, segment_track
from models.estimation.shot_hypotheses.weigh_hypotheses import weigh_events
from models.estimation.structure_search.initial_rests import insert_initial_rests
from models.estimation.structure_search.missed_cushions import refit_rebounds
from models.estimation.structure_search.pass_log import log_pass
from models.estimation.structure_search.strike_times import refit_strikes
from models.estimation.structure_search.structure_revision import remove_unexplained_contacts, revise_graph
from models.tracking.track_noise import (
    NOISE_FLOOR_RADII,
    TrackNoise,
    apply_noise,
    estimate_noise,
    find_outliers,
    find_rarely_detected,
)

_MAX_LISTED = 3
"""Velocity changes that a warning lists."""


def fit_shot(
    tracks: Tracks,
    scene: Scene,
    options: FitOptions = FitOptions(),
    progress: Progress = ignore_progress,
    marks: tuple[ContactCorrection, ...] = (),
) -> Fit:
    """Fit events, motion and coefficients of one clip.

    Never raises for odd tracks: motion that physics cannot explain is `measured` in the trajectory, and `trust` reports
    it.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        options: Prices and limits.
        progress: Called with the finished share of the work.
        marks: Contacts that a person marked, moved or deleted: strong priors.

    Returns:
        The fit.
    """
    return fit_with_solution(tracks, scene, options, progress, marks)[0]


def fit_with_solution(
    tracks: Tracks,
    scene: Scene,
    options: FitOptions = FitOptions(),
    progress: Progress = ignore_progress,
    marks: tuple[ContactCorrection, ...] = (),
) -> tuple[Fit, JointSolution | None]:
    """Fit a clip as `fit_shot`, and return the parameters behind it with their covariance.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        options: Prices and limits.
        progress: Called with the finished share of the work.
        marks: Contacts that a person marked, moved or deleted: strong priors.

    Returns:
        The fit and the joint solution; None where physics could not be fitted.
    """
    solution = None
    clock = estimate_capture_times(tracks, NOISE_FLOOR_RADII * scene.table.ball_radius)
    capture_tracks = replace(tracks, t=clock.capture_time)
    resolved, missing = resolve_marks(marks, capture_tracks)
    try:
        fit, solution = _fit_tracks(capture_tracks, clock.sigma, scene.table, options, progress, resolved)
    except np.linalg.LinAlgError as failure:
        fit = _fit_without_physics(capture_tracks, options, f"The fit failed: {failure}; paths are as measured.")
    if len(tracks.t):
        fit = _refine_events(fit, capture_tracks, scene, resolved)
    fit = replace(fit, mark_outcomes=(*fit.mark_outcomes, *missing))
    warnings = (*scene.warnings, *warn_of_contact_ball_size(fit.parameters, scene))
    return _convert_to_presentation_time(replace(fit, trust=add_warnings(fit.trust, warnings)), tracks, clock), solution


def _refine_events(fit: Fit, tracks: Tracks, scene: Scene, marks: tuple[ResolvedMark, ...] = ()) -> Fit:
    """Refine the times of ball contacts by exact physics, test the passes that may have been grazes, weigh marks."""
    arguments = fit.trajectory, scene.table, scene.camera
    events = refine_contact_times(make_shot_record(tracks, fit.events, *arguments))
    explanation = align_moments(fit.explanation, events)
    passes = find_close_passes(make_shot_record(tracks, events, *arguments, explanation))
    events, explanation = add_close_passes(events, explanation, passes, tracks)
    if fit.mark_outcomes:
        events, explanation = weigh_marks(events, explanation, marks, fit.mark_outcomes, tracks)
    explanation = mark_unexplained_motion(explanation, fit.trajectory, tracks)
    trust = add_warnings(fit.trust, _warn_of_unexplained_changes(explanation))
    return replace(fit, events=events, explanation=explanation, trust=trust)


def _warn_of_unexplained_changes(explanation: ShotExplanation) -> tuple[str, ...]:
    """Return a warning that names velocity changes whose most probable cause is unknown; empty without any."""
    unknown = [(one.t, one.ball) for one in explanation.moments if one.best.cause == "unexplained"]
    if not unknown:
        return ()
    places = ", ".join(f"{ball} at {t:.2f} s" for t, ball in unknown[:_MAX_LISTED])
    more = " ..." if len(unknown) > _MAX_LISTED else ""
    return (f"{len(unknown)} unexplained velocity change{'s' if len(unknown) > 1 else ''}: {places}{more}.",)


def fit_contact_graph(graph: ContactGraph, tracks: Tracks, scene: Scene, options: FitOptions = FitOptions()) -> Fit:
    """Fit a known contact graph: states, times and coefficients are fitted, its contacts stay.

    The tracks' sigmas are used as they are; samples before the first segment of a ball must be left out.

    Args:
        graph: The contact graph.
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        options: Limits.

    Returns:
        The fit.
    """
    observations = collect_observations(tracks)
    solution = refine_graph(graph, observations, scene.table, iterations=60)
    fit = _build_fit_result(
        add_covariance(solution, observations, scene.table), (), tracks, tracks, observations, scene.table, options
    )
    return _refine_events(fit, tracks, scene)


def _convert_to_presentation_time(fit: Fit, tracks: Tracks, clock: CaptureClock) -> Fit:
    """Convert a fit from capture times to presentation times."""
    if clock.capture_time is clock.presentation_time:
        return fit
    t = clock.presentation_time_at(fit.events.t)
    events = replace(
        fit.events,
        t=t,
        t_sigma=fit.events.t_sigma * clock.presentation_rate_at(fit.events.t),
        frame=frame_at(tracks, t),
    )
    explanation = convert_times(fit.explanation, clock)
    outcomes = tuple(
        replace(one, t=float(clock.presentation_time_at(np.array([one.t]))[0])) for one in fit.mark_outcomes
    )
    motion = fit.trajectory
    motion = replace(
        motion, start=clock.presentation_time_at(motion.start), end=clock.presentation_time_at(motion.end), clock=clock
    )
    offset = clock.capture_time - clock.presentation_time
    note = (
        f"Frames were dropped, duplicated or late: their capture times deviate by up to {1e3 * np.ptp(offset):.0f} ms."
    )
    return replace(
        fit,
        events=events,
        trajectory=motion,
        explanation=explanation,
        mark_outcomes=outcomes,
        trust=Trust(fit.trust.level, (*fit.trust.reasons, note)),
    )


def _fit_tracks(
    tracks: Tracks,
    capture_sigma: FloatArray,
    table: Table,
    options: FitOptions,
    progress: Progress,
    marks: tuple[ResolvedMark, ...] = (),
) -> tuple[Fit, JointSolution | None]:
    """Fit tracks at their capture times (T,), known to `capture_sigma` (T,) s."""
    noise = estimate_noise(tracks, 5 * options.moving_speed, table.ball_radius)
    noise = replace(noise, timing=np.hypot(noise.timing, capture_sigma))
    is_rare = find_rarely_detected(tracks)
    selected = apply_noise(_remove_unreliable_samples(tracks, noise, is_rare), noise)
    all_observations = observations = collect_observations(selected)
    if len(observations.t) == 0:
        return _fit_without_physics(tracks, options, "No ball was detected."), None
    prices = (options.break_price, options.free_price)

    def log(name: str, after: JointSolution) -> JointSolution:
        return log_pass(name, solution, after, prices)

    solution = refine_graph(_build_initial_graph(selected, table, options), observations, table)
    progress(0.4)
    solution = log("initial rests", insert_initial_rests(solution, observations, selected, table, prices))
    solution = log("strike times", refit_strikes(solution, observations, table))
    solution = log("rebounds", refit_rebounds(solution, observations, table))
    if marks:
        solution = log("marks by hand", apply_marks(solution, marks, MarkedFit(observations, table, prices)))
    progress(0.6)
    solution = log("structure search", revise_graph(solution, observations, table, *prices))
    solution = log("initial rests", insert_initial_rests(solution, observations, selected, table, prices))
    reestimated = reestimate_noise(selected, tracks, noise, solution, observations)
    if reestimated is not None:
        selected = reestimated
        observations = replace(observations, whiten=collect_observations(selected).whiten)
        solution = log("new noise", refine_graph(solution.graph, observations, table, initial=solution))
        solution = log("structure search", revise_graph(solution, observations, table, *prices))
    solution = log("strike times", refit_strikes(solution, observations, table))
    solution = log("rebounds", refit_rebounds(solution, observations, table))
    after_breaks, observations, breaks = reconstruct_breaks(solution, observations, table)
    solution = log("simulated breaks", after_breaks)
    if breaks:
        all_observations = select_outside_breaks(all_observations, breaks)
        solution = log("structure search", revise_graph(solution, observations, table, *prices, 1))
    excess = _excess_chi2(solution, observations)
    if np.any(excess > 1.5):  # systematic model errors count as noise
        observations = replace(observations, whiten=observations.whiten / np.sqrt(excess)[:, None, None])
        solution = log("misfit as noise", refine_graph(solution.graph, observations, table, 10, solution))
        fewer = remove_unexplained_contacts(solution, observations, table, options.free_price)
        solution = log("remove needless contacts", fewer)
    progress(0.9)
    outcomes: tuple[MarkOutcome, ...] = ()
    if marks:
        marked, outcomes = settle_marks(solution, marks, MarkedFit(observations, table, prices), tracks.ids)
        solution = log("marks by hand", marked)
    solution = add_covariance(solution, observations, table)
    if marks:
        solution, outcomes = condition_on_marks(solution, marks, outcomes, observations)
    fit = _build_fit_result(solution, breaks, tracks, selected, all_observations, table, options)
    fit = replace(fit, mark_outcomes=outcomes)
    progress(1.0)
    return fit, solution


def _remove_unreliable_samples(tracks: Tracks, noise: TrackNoise, is_rare: NDArray[np.bool_]) -> Tracks:
    """Remove balls that are `is_rare` (N,), and samples far off between good neighbours."""
    xy = tracks.xy.copy()
    xy[~(np.isfinite(tracks.sigma) & np.isfinite(tracks.sigma_along))] = np.nan
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        is_outlier = find_outliers(tracks.t[rows], xy[rows, ball], tracks.sigma[rows, ball] * noise.scale[ball])
        xy[rows if is_rare[ball] else rows[is_outlier], ball] = np.nan
    return replace(tracks, xy=xy)


def _build_initial_graph(tracks: Tracks, table: Table, options: FitOptions) -> ContactGraph:
    """Build the contact graph of the segmented tracks."""
    samples, sigma_xy = [], tracks.sigma_xy
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        sigma = np.sqrt((sigma_xy[rows, ball] ** 2).mean(axis=1))
        samples.append(BallSamples(tracks.t[rows], tracks.xy[rows, ball], sigma, sigma_xy[rows, ball] / sigma[:, None]))
    parts_by_ball = []
    for ball, ball_samples in enumerate(samples):
        allowed = find_contact_opportunities(ball_samples, samples[:ball] + samples[ball + 1 :], table)
        parts = segment_track(ball_samples, allowed, options.break_price, options.free_price)
        parts_by_ball.append(remove_jitter(ball_samples, parts, table.ball_radius) if parts else [])
    parts_by_ball = extend_rest_until_hit(samples, parts_by_ball)
    return build_contact_graph(samples, parts_by_ball, table, tracks.kinds).mark_pushed_strikes()


def _excess_chi2(solution: JointSolution, observations: Observations) -> FloatArray:
    """Return the chi2 per degree of freedom of each sample's segment (K,), 1 to 100.

    With it bad segments do not bend the good ones.
    """
    chi2, _, _ = evaluate_segment_chi2(solution, observations)
    return np.clip(np.nan_to_num(chi2, nan=1.0), 1.0, 100.0)[assign_observations(solution.graph, observations)]


def _build_fit_result(
    solution: JointSolution,
    breaks: tuple[BreakPosterior, ...],
    original: Tracks,
    tracks: Tracks,
    observations: Observations,
    table: Table,
    options: FitOptions,
) -> Fit:
    """Build the fit result; `original` are the tracks as they came, `tracks` the fitted ones."""
    is_accepted = find_accepted_segments(
        solution, observations, table.ball_radius, _pixel_size(original, table.ball_radius)
    )
    chi2, _, _ = evaluate_segment_chi2(solution, observations)
    pocketed = find_pocketed_balls(solution, tracks, table)
    rows = list_events(solution, tracks, table, chi2, pocketed, list_break_contacts(breaks, tracks.ids))
    weighed, explanation = weigh_events(rows, solution, observations, tracks, table, chi2)
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
        + build_break_pieces(breaks)
        + unfitted_pieces,
        original.ids,
    )
    state = trajectory.at(original.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > options.moving_speed
    accepted = np.isfinite(state.xy[..., 0]) & ~state.measured
    share, seconds = _share_of_accepted_time(original.t, moving, accepted)
    chi2_all, noise = _summarize_misfit(solution, observations, is_accepted)
    return Fit(
        collect_events(weighed, tracks),
        trajectory,
        _list_coefficients(solution),
        noise,
        chi2_all,
        original.xy - state.xy,
        moving,
        accepted,
        assess_trust(
            share,
            chi2_all,
            seconds,
            _list_warnings(solution, original.ids, [original.ids[ball] for ball in unfitted_balls]),
        ),
        explanation,
    )


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


def _list_warnings(solution: JointSolution, ids: tuple[str, ...], unfitted_balls: list[str]) -> list[str]:
    """List sentences about results that a user should not rely on."""
    warnings, graph = [], solution.graph
    if jumps := sum(contact.kind == "jump" for contact in graph.contacts):
        warnings.append(f"Paths jump at {jumps} place{'s' if jumps > 1 else ''}: frames may be missing there.")
    if unfitted_balls:
        warnings.append(f"Too few detections to be fitted: {', '.join(unfitted_balls)}.")
    return warnings


def _share_of_accepted_time(
    t: FloatArray, moving: NDArray[np.bool_], accepted: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the share of the moving time that is accepted, and the moving time in ball seconds."""
    step = np.gradient(t)[:, None] if len(t) > 1 else np.ones((len(t), 1))
    seconds = float((moving * step).sum())
    return (
        float((moving & accepted).astype(float).ravel() @ np.broadcast_to(step, moving.shape).ravel()) / seconds
        if seconds
        else 1.0
    ), seconds


def _summarize_misfit(
    solution: JointSolution, observations: Observations, is_accepted: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the chi2 per degree of freedom of accepted segments, outliers trimmed, and the noise per axis, m."""
    owner = assign_observations(solution.graph, observations)
    rows = is_accepted[owner]
    if not rows.any():
        return float("nan"), float("nan")
    residual = evaluate_residuals(solution, observations)[rows]
    size = (np.einsum("kij,kj->ki", observations.whiten[rows], residual) ** 2).sum(axis=1)
    free = sum(2 if solution.graph.segments[k].static else 5 for k in np.unique(owner[rows]))
    chi2 = float(np.minimum(size, 25.0).sum() / max(2 * len(size) - free, 1))
    return chi2, float(np.sqrt(np.median((residual**2).sum(axis=1)) / (2 * np.log(2))))


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


def _fit_without_physics(tracks: Tracks, options: FitOptions, reason: str) -> Fit:
    """Fit curves through the samples, without events, where the physics fit failed."""
    empty = np.empty(0)
    events = Events((), empty, empty, empty, (), (), np.empty((0, 2)), empty, empty, empty, empty)
    trajectory = pack_trajectory(
        [piece for ball in range(len(tracks.ids)) for piece in build_measured_pieces(tracks, ball)], tracks.ids
    )
    state = trajectory.at(tracks.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > options.moving_speed
    never = np.zeros_like(moving)
    _, seconds = _share_of_accepted_time(tracks.t, moving, never)
    trust = Trust("red", (reason,)) if seconds else assess_trust(0.0, float("nan"), 0.0, [reason])
    return Fit(events, trajectory, (), float("nan"), float("nan"), tracks.xy - state.xy, moving, never, trust)
