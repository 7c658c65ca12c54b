"""The fit: tracks in, events and motion between frames out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.capture_clock import Clock
from models.core.events import Events
from models.core.fit_result import Fit, Parameter, Trust
from models.core.options import FitOptions
from models.core.progress import Progress, silent
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.break_shot.break_posterior import ToldBurst
from models.estimation.contact_test.shot_record import record_of
from models.estimation.joint_fit.fit_solution import Data, Solution, gather, layout, owners, residuals
from models.estimation.joint_fit.joint_refinement import refine, with_covariance
from models.estimation.joint_fit.physics_priors import ROLLING_PRIOR, SLIDING_PRIOR
from models.estimation.joint_fit.trust_level import accepted_spans, light, span_chi2, with_doubts
from models.estimation.reconstruction.break_refinement import pieces_in, seen_outside, touches_of, with_bursts
from models.estimation.reconstruction.capture_times import clock_of
from models.estimation.reconstruction.contact_timing import retimed
from models.estimation.reconstruction.event_list import events_of, frame_at, pocketed
from models.estimation.reconstruction.noise_reestimation import reappraised
from models.estimation.reconstruction.trajectory_assembly import measured_pieces, pack, pieces_of
from models.estimation.segmentation.contact_classification import near_something, tell
from models.estimation.segmentation.contact_graph import Story
from models.estimation.segmentation.jitter_removal import resting_until_hit, tidy
from models.estimation.segmentation.track_segmentation import Samples, segment
from models.estimation.structure_search.missed_cushions import with_rebounds_retold
from models.estimation.structure_search.strike_times import with_strikes_retold
from models.estimation.structure_search.structure_revision import revise, without_doubts
from models.tracking.track_noise import FLOOR, Noise, estimate_noise, outliers, seldom_seen, with_noise

_NAMED = 3
"""changes of velocity that a doubt names."""


def fit_shot(tracks: Tracks, scene: Scene, options: FitOptions = FitOptions(), progress: Progress = silent) -> Fit:
    """Events, motion and coefficients of one clip.

    Never raises for odd tracks: what physics cannot explain is `measured` in the trajectory, and `trust` says so.
    """
    return fit_and_solution(tracks, scene, options, progress)[0]


def fit_and_solution(
    tracks: Tracks, scene: Scene, options: FitOptions = FitOptions(), progress: Progress = silent
) -> tuple[Fit, Solution | None]:
    """The same, with the numbers behind it and their covariance; None where physics could not be fitted."""
    solution = None
    clock = clock_of(tracks, FLOOR * scene.table.ball_radius)
    taken = replace(tracks, t=clock.taken)
    try:
        fit, solution = _fitted(taken, clock.sigma, scene.table, options, progress)
    except np.linalg.LinAlgError as failure:
        fit = _measured_only(taken, options, f"The fit failed: {failure}; paths are as measured.")
    timed = (
        retimed(record_of(taken, fit.events, fit.trajectory, scene.table, scene.camera))
        if len(tracks.t)
        else fit.events
    )
    return _as_shown(replace(fit, events=timed, trust=with_doubts(fit.trust, scene.doubts)), tracks, clock), solution


def fit_story(story: Story, tracks: Tracks, scene: Scene, options: FitOptions = FitOptions()) -> Fit:
    """The fit of a story that is known: its states, times and coefficients are sought, its contacts are not doubted.

    Tracks are believed as they are; what was seen before the story of a ball begins has to be left out of them.
    """
    data = gather(tracks)
    solution = refine(story, data, scene.table, iterations=60)
    fit = _report(with_covariance(solution, data, scene.table), (), tracks, tracks, data, scene.table, options)
    return replace(fit, events=retimed(record_of(tracks, fit.events, fit.trajectory, scene.table, scene.camera)))


def _as_shown(fit: Fit, tracks: Tracks, clock: Clock) -> Fit:
    """A fit in the time in which pictures were taken, told in that in which they are shown."""
    if clock.taken is clock.shown:
        return fit
    t = clock.shown_at(fit.events.t)
    events = replace(fit.events, t=t, t_sigma=fit.events.t_sigma * clock.rate(fit.events.t), frame=frame_at(tracks, t))
    motion = fit.trajectory
    motion = replace(motion, start=clock.shown_at(motion.start), end=clock.shown_at(motion.end), clock=clock)
    off = clock.taken - clock.shown
    note = f"Pictures were dropped, held or late: they show moments up to {1e3 * np.ptp(off):.0f} ms off an even time."
    return replace(fit, events=events, trajectory=motion, trust=Trust(fit.trust.light, (*fit.trust.reasons, note)))


def _fitted(
    tracks: Tracks, late: FloatArray, table: Table, options: FitOptions, progress: Progress
) -> tuple[Fit, Solution | None]:
    """The fit of tracks in the times (T,) at which pictures were taken, known to `late` (T,) s."""
    noise = estimate_noise(tracks, 5 * options.moving_speed, table.ball_radius)
    noise = replace(noise, timing=np.hypot(noise.timing, late))
    seldom = seldom_seen(tracks)
    kept = with_noise(_believable(tracks, noise, seldom), noise)
    shown = data = gather(kept)
    if len(data.t) == 0:
        return _measured_only(tracks, options, "No ball was seen."), None
    story = _first_story(kept, table, options)
    progress(0.4)
    solution = refine(story, data, table, iterations=10 if options.quick else 30)
    solution = with_rebounds_retold(with_strikes_retold(solution, data, table), data, table)
    progress(0.6)
    rounds = 1 if options.quick else 3
    solution = revise(solution, data, table, options.break_price, options.free_price, rounds)
    surer = reappraised(kept, tracks, noise, solution, data)
    if surer is not None:
        kept = surer
        data = replace(data, whiten=gather(kept).whiten)
        solution = refine(solution.story, data, table, start=solution)
        solution = revise(solution, data, table, options.break_price, options.free_price, rounds)
    solution = with_rebounds_retold(with_strikes_retold(solution, data, table), data, table)
    bursts: tuple[ToldBurst, ...] = ()
    if not options.quick:
        solution, data, bursts = with_bursts(solution, data, table)
        if bursts:
            shown = seen_outside(shown, bursts)
            solution = revise(solution, data, table, options.break_price, options.free_price, 1)
    excess = _excess(solution, data)
    if np.any(excess > 1.5):  # what the model misses is no smaller for being systematic
        data = replace(data, whiten=data.whiten / np.sqrt(excess)[:, None, None])
        solution = refine(solution.story, data, table, iterations=10, start=solution)
        solution = without_doubts(solution, data, table, options.free_price)
    progress(0.9)
    solution = with_covariance(solution, data, table)
    fit = _report(solution, bursts, tracks, kept, shown, table, options)
    progress(1.0)
    return fit, solution


def _believable(tracks: Tracks, noise: Noise, seldom: NDArray[np.bool_]) -> Tracks:
    """Tracks without balls that were seen `seldom` (N,), and without samples far off between good neighbours."""
    xy = tracks.xy.copy()
    xy[~(np.isfinite(tracks.sigma) & np.isfinite(tracks.sigma_along))] = np.nan
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        bad = outliers(tracks.t[rows], xy[rows, ball], tracks.sigma[rows, ball] * noise.scale[ball])
        xy[rows if seldom[ball] else rows[bad], ball] = np.nan
    return replace(tracks, xy=xy)


def _first_story(tracks: Tracks, table: Table, options: FitOptions) -> Story:
    samples, spread = [], tracks.sigma_xy
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        sigma = np.sqrt((spread[rows, ball] ** 2).mean(axis=1))
        samples.append(Samples(tracks.t[rows], tracks.xy[rows, ball], sigma, spread[rows, ball] / sigma[:, None]))
    segments = []
    for ball, seen in enumerate(samples):
        allowed = near_something(seen, samples[:ball] + samples[ball + 1 :], table)
        parts = segment(seen, allowed, options.break_price, options.free_price)
        segments.append(tidy(seen, parts, table.ball_radius) if parts else [])
    segments = resting_until_hit(samples, segments)
    return tell(samples, segments, table, tracks.kinds).with_pushes()


def _excess(solution: Solution, data: Data) -> FloatArray:
    """chi2 per degree of freedom of the span of each sample (K,), 1 to 100: bad spans shall not bend the good ones."""
    chi2, _, _ = span_chi2(solution, data)
    return np.clip(np.nan_to_num(chi2, nan=1.0), 1.0, 100.0)[owners(solution.story, data)]


def _report(
    solution: Solution, bursts: tuple[ToldBurst, ...], seen: Tracks, tracks: Tracks, data: Data, table: Table,
    options: FitOptions,
) -> Fit:  # fmt: skip
    """The fit as others see it; `seen` are the tracks as they came, `tracks` those that were fitted."""
    good = accepted_spans(solution, data, table.ball_radius, _pixel(seen, table.ball_radius))
    chi2, _, _ = span_chi2(solution, data)
    potted = pocketed(solution, tracks, table)
    events = events_of(solution, tracks, table, chi2, potted, touches_of(bursts, tracks.ids))
    ends = {tracks.ids.index(event.a): event.t for event in potted}
    left_out = [
        ball for ball in range(len(seen.ids)) if seen.observed[:, ball].any() and not tracks.observed[:, ball].any()
    ]
    unfitted = [piece for ball in left_out for piece in measured_pieces(seen, ball)]
    whole = (float(tracks.t[0]), float(tracks.t[-1]))
    trajectory = pack(
        pieces_of(solution, data, good, len(seen.ids), whole, table.ball_radius, ends) + pieces_in(bursts) + unfitted,
        seen.ids,
    )
    state = trajectory.at(seen.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > options.moving_speed
    accepted = np.isfinite(state.xy[..., 0]) & ~state.measured
    share, seconds = _share(seen.t, moving, accepted)
    chi2_all, noise = _misfit(solution, data, good)
    return Fit(
        events, trajectory, _parameters(solution), noise, chi2_all, seen.xy - state.xy, moving, accepted,
        light(share, chi2_all, seconds, _doubts(solution, seen.ids, [seen.ids[ball] for ball in left_out])),
    )  # fmt: skip


def _pixel(tracks: Tracks, radius: float) -> float:
    """What a pixel shows where the balls are, root mean square per axis, m; 0 where their size there is not known."""
    known = tracks.observed & np.isfinite(tracks.radius_px) & (tracks.radius_px > 0)
    if not known.any():
        return 0.0
    # the silhouette of a ball has the scale of the direction that no view foreshortens
    least = 1.0 if tracks.lay is None else np.linalg.norm(tracks.lay[known], -2, axis=(1, 2))
    return float(np.median(radius / tracks.radius_px[known] / least))


def _doubts(solution: Solution, ids: tuple[str, ...], left_out: list[str]) -> list[str]:
    """Sentences on what a user should not rely on."""
    found, story = [], solution.story
    if free := sorted((c.t, ids[story.spans[c.before[0]].ball]) for c in story.contacts if c.kind == "free"):
        where = ", ".join(f"{ball} at {t:.2f} s" for t, ball in free[:_NAMED]) + (" ..." if len(free) > _NAMED else "")
        found.append(f"{len(free)} change{'s' if len(free) > 1 else ''} of velocity without a known cause: {where}.")
    if jumps := sum(contact.kind == "jump" for contact in story.contacts):
        found.append(f"Paths jump at {jumps} place{'s' if jumps > 1 else ''}: pictures may be missing there.")
    if left_out:
        found.append(f"Seen too seldom to be fitted: {', '.join(left_out)}.")
    return found


def _share(t: FloatArray, moving: NDArray[np.bool_], accepted: NDArray[np.bool_]) -> tuple[float, float]:
    """Share of the moving time that is accepted, and the moving time in ball seconds."""
    step = np.gradient(t)[:, None] if len(t) > 1 else np.ones((len(t), 1))
    seconds = float((moving * step).sum())
    return (
        float((moving & accepted).astype(float).ravel() @ np.broadcast_to(step, moving.shape).ravel()) / seconds
        if seconds
        else 1.0
    ), seconds


def _misfit(solution: Solution, data: Data, good: NDArray[np.bool_]) -> tuple[float, float]:
    """chi2 per degree of freedom of accepted spans, single outliers trimmed, and the noise per axis in m."""
    owner = owners(solution.story, data)
    rows = good[owner]
    if not rows.any():
        return float("nan"), float("nan")
    miss = residuals(solution, data)[rows]
    size = (np.einsum("kij,kj->ki", data.whiten[rows], miss) ** 2).sum(axis=1)
    free = sum(2 if solution.story.spans[k].static else 5 for k in np.unique(owner[rows]))
    chi2 = float(np.minimum(size, 25.0).sum() / max(2 * len(size) - free, 1))
    return chi2, float(np.sqrt(np.median((miss**2).sum(axis=1)) / (2 * np.log(2))))


def _parameters(solution: Solution) -> tuple[Parameter, ...]:
    """Coefficients with errors; those that the clip did not determine keep most of their prior's error."""
    first = layout(solution.story).globals
    sigma = np.sqrt(np.diag(solution.covariance)[first:])
    friction = solution.friction
    found = []
    for name, value, spread, prior in (
        ("sliding_friction.mu", friction.sliding, sigma[0], SLIDING_PRIOR[1]),
        ("rolling_resistance.mu", friction.rolling, sigma[1], ROLLING_PRIOR[1]),
    ):
        found.append(Parameter(name, value, float(value * spread), "", bool(spread > 0.8 * prior)))
    return tuple(found)


def _measured_only(tracks: Tracks, options: FitOptions, why: str) -> Fit:
    """The fit of tracks that physics could not be fitted to: curves through what was seen, no events."""
    none = np.empty(0)
    events = Events((), none, none, none, (), (), np.empty((0, 2)), none, none, none, none)
    trajectory = pack([p for ball in range(len(tracks.ids)) for p in measured_pieces(tracks, ball)], tracks.ids)
    state = trajectory.at(tracks.t)
    moving = np.linalg.norm(np.nan_to_num(state.v), axis=2) > options.moving_speed
    nowhere = np.zeros_like(moving)
    _, seconds = _share(tracks.t, moving, nowhere)
    trust = Trust("red", (why,)) if seconds else light(0.0, float("nan"), 0.0, [why])
    return Fit(events, trajectory, (), float("nan"), float("nan"), tracks.xy - state.xy, moving, nowhere, trust)
