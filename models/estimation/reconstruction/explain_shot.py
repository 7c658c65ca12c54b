"""Explanation of a recording: tracks in, contact graph with states, times and covariance out, as one `Shot`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import ContactGraph
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.joint_solution import JointSolution, Observations
from models.core.options import FitOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene, Table
from models.core.shot import ContactRivals, ContactTestResult, Note, Shot
from models.core.shot_explanation import MarkOutcome
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.hand_marks.graph_marks import (
    MarkedFit,
    apply_marks,
    combine_marked_times,
    contradict_unheld_marks,
    settle_marks,
)
from models.estimation.hand_marks.resolved_marks import ResolvedMark, resolve_marks
from models.estimation.joint_fit.fit_solution import assign_observations, collect_observations, evaluate_residuals
from models.estimation.joint_fit.joint_refinement import add_covariance, condition_on_contact_times, refine_graph
from models.estimation.joint_fit.trust_level import evaluate_segment_chi2
from models.estimation.reconstruction.break_refinement import reconstruct_breaks
from models.estimation.reconstruction.capture_times import estimate_capture_times
from models.estimation.reconstruction.close_passes import list_close_passes
from models.estimation.reconstruction.contact_time_refinement import refine_contact_times
from models.estimation.segmentation.contact_classification import build_contact_graph, find_contact_opportunities
from models.estimation.segmentation.jitter_removal import extend_rest_until_hit, remove_jitter
from models.estimation.segmentation.track_segmentation import BallSamples, segment_track
from models.estimation.shot_hypotheses.rival_causes import collect_hypotheses
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
    reestimated = _reestimate_noise(selected, tracks, noise, solution, observations)
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
        solution = log("structure search", revise_graph(solution, observations, table, *prices, 1))
    measured = observations
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
    tests = refine_contact_times(solution, measured, blank.scene)
    times = {number: (one.t, one.t_sigma) for number, one in tests.items()}
    times, outcomes = combine_marked_times(solution, times, marks, outcomes, observations)
    solution = condition_on_contact_times(solution, times, observations, table)
    outcomes = contradict_unheld_marks(solution, marks, outcomes)
    shot = replace(
        blank, whitening=whitening, solution=solution, breaks=breaks, outcomes=(*outcomes, *blank.outcomes),
        hypotheses=(ContactRivals((), 0.0),) * len(solution.graph.contacts), gaps=list_gaps(solution, tests),
    )  # fmt: skip
    shot = replace(shot, hypotheses=collect_hypotheses(solution, shot.observations, table))
    progress(1.0)
    return shot


def list_gaps(solution: JointSolution, tests: Mapping[int, ContactTestResult]) -> FloatArray:
    """List the gaps (C, 2) and their sigmas of contacts by their contact tests; NaN where there is none."""
    gaps = np.full((len(solution.graph.contacts), 2), np.nan)
    for number, one in tests.items():
        gaps[number] = one.gap, one.gap_sigma
    return gaps


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


_NOISE_WINDOW_SAMPLES = 25
"""Samples of a ball over which the residuals are averaged."""
_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
_FITTED_SHARE = 0.85
"""Residuals over errors where a segment of about fifteen samples is fitted with five parameters and its contacts."""
_NOTABLE_SHRINKAGE = 0.8
"""Errors that shrink by less than this factor are left unchanged."""


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
