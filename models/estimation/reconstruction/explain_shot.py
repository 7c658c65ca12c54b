"""Explanation of a recording: tracks in, contact graph with states, times and covariance out, as one `Shot`.

A simulation replaces each ball's motion in a break shot until its last contact there. Contacts are timed last:
`contact_times` says how a contact gets its time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.fit_result import MarkOutcome
from models.core.options import FitOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene, Table
from models.core.shot import (
    ClosePass,
    ContactRivals,
    Note,
    Shot,
    SimulatedBreak,
    select_outside_breaks,
)
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.break_shot.break_search import search_break, summarize_break
from models.estimation.contact_test.contact_motion import USUAL_CLOTH, ClothPriors
from models.estimation.contact_test.shot_record import find_close_passes, make_shot_record
from models.estimation.hand_marks.graph_marks import (
    apply_marks,
    combine_marked_times,
    contradict_unheld_marks,
    settle_marks,
)
from models.estimation.hand_marks.resolved_marks import ResolvedMark, resolve_marks
from models.estimation.joint_fit.contact_cascades import find_segment_at
from models.estimation.joint_fit.fit_solution import assign_observations, collect_observations, evaluate_residuals
from models.estimation.joint_fit.joint_refinement import add_covariance, condition_on_contact_times, refine_graph
from models.estimation.joint_fit.trust_level import evaluate_segment_chi2
from models.estimation.reconstruction.capture_times import estimate_capture_times
from models.estimation.reconstruction.contact_times import list_gaps, refine_contact_times
from models.estimation.reconstruction.plausibility import find_implausible_deceleration
from models.estimation.reconstruction.shot_views import view_captured
from models.estimation.segmentation.contact_classification import build_contact_graph, find_contact_opportunities
from models.estimation.segmentation.jitter_removal import extend_rest_until_hit, remove_jitter
from models.estimation.segmentation.track_segmentation import BallSamples, segment_track
from models.estimation.structure_search.contact_partners import collect_hypotheses
from models.estimation.structure_search.missed_cushions import refit_rebounds
from models.estimation.structure_search.motion_starts import insert_initial_rests, refit_strikes
from models.estimation.structure_search.rack_detection import find_break_shots, rest_start_time
from models.estimation.structure_search.structure_revision import remove_unexplained_contacts, revise_graph
from models.estimation.structure_search.structure_trials import StructureSearch
from models.tracking.track_noise import (
    NOISE_FLOOR_RADII,
    TrackNoise,
    apply_noise,
    estimate_noise,
    find_outliers,
    find_rarely_detected,
)


def explain(
    tracks: Tracks,
    scene: Scene,
    options: FitOptions = FitOptions(),
    progress: Progress = ignore_progress,
    corrections: Corrections = NO_CORRECTIONS,
    notes: tuple[Note, ...] = (),
) -> Shot:
    """Explain the recording of a shot; this is the only inference on a whole shot.

    Never raises for odd tracks: motion that physics cannot explain is `measured` in the trajectory, and the trust level
    reports it.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        options: Prices and limits.
        progress: Called with the finished share of the work.
        corrections: What a person corrected; contacts that were marked, moved or deleted are strong priors.
        notes: Remarks on the recording.

    Returns:
        The shot.
    """
    clock = estimate_capture_times(tracks, NOISE_FLOOR_RADII * scene.table.ball_radius)
    captured = replace(tracks, t=clock.capture_time)
    marks, missing = resolve_marks(corrections.contacts, captured)
    blank = Shot(
        scene, tracks, clock, np.full((*tracks.xy.shape, 2), np.nan), None, corrections=corrections, outcomes=missing,
        notes=notes, moving_speed=options.moving_speed,
    )  # fmt: skip
    try:
        shot = _explain_tracks(blank, captured, options, progress, marks)
    except np.linalg.LinAlgError as failure:
        shot = replace(blank, notes=(*notes, Note("fit_failed", str(failure))))
    if shot.solution is not None:
        deceleration = find_implausible_deceleration(shot.solution, captured, scene.table)
        if deceleration is not None:
            shot = replace(shot, notes=(*shot.notes, Note("implausible_deceleration", f"{deceleration:.2g}")))
    return replace(shot, passes=list_close_passes(shot))


def _explain_tracks(
    blank: Shot, tracks: Tracks, options: FitOptions, progress: Progress, marks: tuple[ResolvedMark, ...]
) -> Shot:
    """Explain tracks at their capture times; `blank` is the shot without an explanation."""
    table = blank.scene.table
    noise = estimate_noise(tracks, 5 * options.moving_speed, table.ball_radius)
    noise = replace(noise, timing=np.hypot(noise.timing, blank.clock.sigma))
    is_rare = find_rarely_detected(tracks)
    selected = apply_noise(_remove_unreliable_samples(tracks, noise, is_rare), noise)
    whitening = whiten_observed(selected)
    observations = collect_observations(selected)
    if len(observations.t) == 0:
        return replace(blank, notes=(*blank.notes, Note("no_ball")))
    search = StructureSearch(observations, table, (options.break_price, options.free_price))

    def log(name: str, after: JointSolution) -> JointSolution:
        return search.log_pass(name, solution, after)

    solution = refine_graph(_build_initial_graph(selected, table, options), observations, table)
    progress(0.4)
    solution = log("initial rests", insert_initial_rests(solution, search, selected))
    solution = log("strike times", refit_strikes(solution, search))
    solution = log("rebounds", refit_rebounds(solution, search))
    if marks:
        solution = log("marks by hand", apply_marks(solution, marks, search))
    progress(0.6)
    solution = log("structure search", revise_graph(solution, search))
    solution = log("initial rests", insert_initial_rests(solution, search, selected))
    reestimated = _reestimate_noise(selected, tracks, noise, solution, observations)
    if reestimated is not None:
        selected = reestimated
        observations = replace(observations, whiten=collect_observations(selected).whiten)
        search = search.restart(observations)
        solution = log("new noise", refine_graph(solution.graph, observations, table, initial=solution))
        solution = log("structure search", revise_graph(solution, search))
    solution = log("strike times", refit_strikes(solution, search))
    solution = log("rebounds", refit_rebounds(solution, search))
    after_breaks, observations, breaks = reconstruct_breaks(solution, observations, table)
    search = search.restart(observations)
    solution = log("simulated breaks", after_breaks)
    if breaks:
        solution = log("structure search", revise_graph(solution, search, 1))
    measured = observations
    excess = _excess_chi2(solution, observations)
    if np.any(excess > 1.5):  # systematic model errors count as noise
        observations = replace(observations, whiten=observations.whiten / np.sqrt(excess)[:, None, None])
        search = search.restart(observations)
        solution = log("misfit as noise", refine_graph(solution.graph, observations, table, 10, solution))
        solution = log("remove needless contacts", remove_unexplained_contacts(solution, search))
    progress(0.9)
    outcomes: tuple[MarkOutcome, ...] = ()
    if marks:
        marked, outcomes = settle_marks(solution, marks, search, tracks.ids)
        solution = log("marks by hand", marked)
    solution = add_covariance(solution, observations, table)
    tests = refine_contact_times(solution, measured, blank.scene)
    times = {number: (one.t, one.t_sigma) for number, one in tests.items()}
    times, outcomes = combine_marked_times(solution, times, marks, outcomes, observations)
    solution = condition_on_contact_times(solution, times, observations, table)
    outcomes = contradict_unheld_marks(solution, marks, outcomes)
    shot = replace(
        blank, whitening=whitening, solution=solution, breaks=breaks, outcomes=(*outcomes, *blank.outcomes),
        hypotheses=(ContactRivals((), 0.0),) * len(solution.graph.contacts), gaps=list_gaps(solution, tests),
    )  # fmt: skip
    shot = replace(shot, hypotheses=collect_hypotheses(solution, search.restart(shot.observations)))
    progress(1.0)
    return shot


def whiten_observed(tracks: Tracks) -> FloatArray:
    """Return the whitening matrices (T, N, 2, 2) of the observed positions; NaN elsewhere."""
    return np.where(tracks.is_observed[..., None, None], tracks.whitening, np.nan)


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


# Samples of a ball over which the residuals are averaged.
_NOISE_WINDOW_SAMPLES = 25
# Median of the absolute value of a standard normal number.
_NORMAL_MEDIAN = 0.6745
# Residuals over errors where a segment of about fifteen samples is fitted with five parameters and its contacts.
_FITTED_SHARE = 0.85
# Errors that shrink by less than this factor are left unchanged.
_NOTABLE_SHRINKAGE = 0.8


def _reestimate_noise(
    tracks: Tracks, original: Tracks, noise: TrackNoise, solution: JointSolution, observations: Observations
) -> Tracks | None:
    """Reduce the errors of `tracks` where the residuals are smaller; None if they hardly are.

    No error becomes smaller than that of `original` times the usual noise of the clip. `observations` are the samples
    of `tracks` in the order of `fit_solution.collect_observations`.
    """
    usual_scale = float(np.median(noise.scale))
    residual = np.abs(
        np.einsum("kij,kj->ki", observations.whiten, evaluate_residuals(solution, observations))
    )  # along, across
    sizes = np.stack([tracks.sigma_along, tracks.sigma], axis=-1)  # (T, N, 2)
    stated = np.stack([original.sigma_along, original.sigma], axis=-1)
    least = np.hypot(stated * usual_scale, noise.floor)
    reduced = sizes.copy()
    for ball in np.unique(observations.ball):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        ratio = _running_median(residual[observations.ball == ball]) / (_NORMAL_MEDIAN * _FITTED_SHARE)
        reduced[rows, ball] = np.clip(
            sizes[rows, ball] * ratio, np.minimum(least, sizes)[rows, ball], sizes[rows, ball]
        )
    shrunk = (reduced < _NOTABLE_SHRINKAGE * sizes)[tracks.is_observed]
    if not shrunk.any():
        return None
    return replace(tracks, sigma_along=reduced[..., 0], sigma=reduced[..., 1])


def _running_median(values: FloatArray) -> FloatArray:
    """Return the median (n, 2) of the values (n, 2) around each."""
    half = min(_NOISE_WINDOW_SAMPLES, len(values)) // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect" if half < len(values) else "edge")
    medians: FloatArray = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)
    return medians


# Per degree of freedom, robust: a simulation with a larger misfit explains nothing.
MAX_BREAK_CHI2 = 20.0
# chi2: gain of contacts from a simulation, which the structure search does not question.
CERTAIN_GAIN = 1e6
# s: a moment later.
TIME_EPSILON = 1e-9
# Factor on the variances of the simulation, since it already used the samples after the break.
VARIANCE_FACTOR = 2.0
# Of the random racks: the same clip gives the same simulation.
_SEED = 1987


def reconstruct_breaks(
    solution: JointSolution, observations: Observations, table: Table
) -> tuple[JointSolution, Observations, tuple[SimulatedBreak, ...]]:
    """Replace break shots by simulations where these explain the samples.

    Returns the solution, the observations that the rest of the graph has to explain, and the break shots.
    """
    generator = np.random.default_rng(_SEED)
    breaks = []
    for break_shot in find_break_shots(solution, observations, table):
        ensemble = search_break(break_shot, generator)
        if ensemble is None or ensemble.chi2_per_dof > MAX_BREAK_CHI2:
            continue
        posterior = summarize_break(ensemble)
        if posterior.contacts:
            breaks.append(posterior)
    if not breaks:
        return solution, observations, ()
    graph = solution.graph
    for posterior in breaks:
        graph = _insert_break(graph, posterior)
    remaining = _add_arrival_observations(select_outside_breaks(observations, tuple(breaks)), tuple(breaks))
    return refine_graph(graph, remaining, table, initial=solution), remaining, tuple(breaks)


def _insert_break(graph: ContactGraph, posterior: SimulatedBreak) -> ContactGraph:
    """Let balls leave a break as simulated."""
    end = max(ball_exit.end for ball_exit in posterior.exits) + posterior.interval
    starts = {ball_exit.ball: _last_reliable_time(graph, posterior, ball_exit.ball) for ball_exit in posterior.exits}
    while removed := [
        k for k, c in enumerate(graph.contacts)
        if c.kind != "break" and (c.t <= posterior.hit or c.kind != "cushion")
        and any(starts[ball] < c.t <= end for ball in starts.keys() & graph.balls_at(c))
    ]:  # fmt: skip
        graph = graph.remove_contact(removed[-1])
    for ball_exit in posterior.exits:
        k = find_segment_at(graph, ball_exit.ball, ball_exit.end)
        whiten = np.linalg.inv(np.linalg.cholesky(VARIANCE_FACTOR * ball_exit.covariance))
        contact = Contact(
            "break",
            ball_exit.end,
            (k,),
            (),
            gain=CERTAIN_GAIN,
            break_start=ball_exit.start,
            exit_state=ball_exit.state,
            exit_whitening=whiten,
        )
        graph = graph.insert_contact(contact, (np.concatenate([ball_exit.state, np.zeros(2)]),))
    return graph.mark_pushed_strikes()


def _add_arrival_observations(observations: Observations, breaks: tuple[SimulatedBreak, ...]) -> Observations:
    """Add the place of each ball at its first contact in a break as an observation."""
    exits = [one for posterior in breaks for one in posterior.exits]
    ball = np.concatenate([observations.ball, np.array([one.ball for one in exits], dtype=np.int64)])
    t = np.concatenate([observations.t, [one.start - TIME_EPSILON for one in exits]])
    xy = np.concatenate([observations.xy, [one.arrival for one in exits]])
    whitening = [np.linalg.inv(np.linalg.cholesky(VARIANCE_FACTOR * one.arrival_covariance)) for one in exits]
    order = np.lexsort((t, ball))
    return Observations(ball[order], t[order], xy[order], np.concatenate([observations.whiten, whitening])[order])


def _last_reliable_time(graph: ContactGraph, one: SimulatedBreak, ball: int) -> float:
    """Return the time, s, until which the graph of a ball holds: as it comes in, or starts to rest."""
    if ball == one.balls[0]:
        return graph.start_time(find_segment_at(graph, ball, one.start + TIME_EPSILON))
    return rest_start_time(graph, ball, one.hit)


def list_close_passes(shot: Shot, cloth: ClothPriors = USUAL_CLOTH) -> tuple[ClosePass, ...]:
    """List the passes of a shot that may have been contacts, with the results of their tests.

    Args:
        shot: The shot; its own passes do not count.
        cloth: What is known about the friction of the cloth.

    Returns:
        The passes.
    """
    if not len(shot.tracks.t):
        return ()
    view, scene = view_captured(replace(shot, passes=())), shot.scene
    record = make_shot_record(
        shot.capture_tracks, view.events, view.trajectory, scene.table, scene.camera, view.explanation
    )
    return find_close_passes(replace(record, cloth=cloth))
