"""Capture times of frames, estimated from the motion of all balls.

Containers present frames at even times, conversions and cameras take them at others: a conversion from 30 to 25 fps
drops every sixth frame, a screen recording keeps frames as they come, a busy camera loses some. Everything that moves
then jumps or lags *together*, which no contact does, and along its path only. So short windows of all moving balls are
fitted by parabolas of a common time; the scatter across the path gives the noise, that along it the clock. Capture
times equal presentation times unless the evidence for another clock is strong (empirical Bayes: MacKay 1992,
doi:10.1162/neco.1992.4.3.415).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray, IntArray

# Samples that share a parabola: fewer let the clock drift within a few windows, more are cut by contacts.
WINDOW = 9
# Degrees of freedom of a window: a larger robust chi2 has another cause, and counts for less.
WINDOW_DOF = WINDOW - 3.0
# Share of a window's misfit that is independent: each sample is in nine windows.
INDEPENDENT_SHARE = 1 / WINDOW_DOF
# m/s^2, prior standard deviation along the path: sliding friction.
ACCELERATION = 2.0
# Standard deviations that a ball moves from sample to sample, at least: a slower one gives no time.
MIN_STEP_SIGMAS = 4.0
# Least cosine between a step and the displacement of a window: contacts turn, clocks do not.
MIN_COSINE = 0.94
# Longest over shortest step: beyond, the ball was struck or stopped.
MAX_STEP_RATIO = 8.0
# chi2 of a window that counts half: contacts along the path do not concern the clock.
SOFT_CHI2 = 75.0
# Frames from one dropped frame to the next: 30 to 25 fps drops one after five, 24 to 23 fps one after 23.
LONGEST_CADENCE = 12
# chi2 that another clock must explain, whatever its parameters: a window or two may be wrong.
MIN_CLOCK_GAIN = 30.0
# Frames lost at once.
MAX_LOST_FRAMES = 3
# Frame intervals: standard deviations of the tried time jitters.
JITTERS = (0.05, 0.15, 0.4)
# Median of chi2 with six degrees of freedom.
_CHI2_MEDIAN = 5.348
# Steps of the optimization; during the first of them windows with a bad fit count more.
MAX_STEPS, ANNEALING_STEPS = 12, 4


@dataclass(frozen=True, slots=True)
class _MotionWindows:
    """W runs of `WINDOW` successive samples of a moving ball."""

    row: IntArray
    """(W, 9) frame indices."""
    along: FloatArray
    """(W, 9) m along the mean direction."""
    sigma: FloatArray
    """(W,) m, one standard deviation along the path."""
    across: FloatArray
    """(W, 9) m, perpendicular to it."""
    sigma_across: FloatArray
    """(W,) m."""

    def select_windows(self, rows: NDArray[np.bool_]) -> _MotionWindows:
        """Select some windows."""
        return _MotionWindows(
            *(getattr(self, name)[rows] for name in ("row", "along", "sigma", "across", "sigma_across"))
        )


def estimate_capture_times(tracks: Tracks, floor: float) -> CaptureClock:
    """Estimate the capture times of all frames from the motion of all balls.

    Args:
        tracks: Tracks over T frames with their presentation times.
        floor: Error of a sample that does not average out, m.

    Returns:
        The clock; that of the container where it explains the motion.
    """
    presentation = CaptureClock(tracks.t, tracks.t, np.zeros(len(tracks.t)))
    windows = _collect_windows(tracks)
    if len(tracks.t) < 2 * WINDOW or len(windows.row) < WINDOW:
        return presentation
    interval = float(np.median(np.diff(tracks.t)))
    windows = _rescale_sigmas(windows, tracks.t, floor)
    bases = [_estimate_cadence(windows, tracks.t, interval), *_even_times(tracks.t, interval)]
    options = [t for base in bases for t in _insert_losses(windows, base, interval)]
    best, capture, sigma = max((_estimate_jitter(windows, t, interval) for t in options), key=lambda option: option[0])
    unchanged = -_robust_misfit(windows, tracks.t) / 2
    return CaptureClock(tracks.t, capture, sigma) if best - unchanged > MIN_CLOCK_GAIN / 2 else presentation


def _collect_windows(tracks: Tracks) -> _MotionWindows:
    """Collect the windows in which balls move steadily enough to give the time."""
    ball, rows = _find_steady_runs(tracks)
    xy = tracks.xy[rows, ball[:, None]]  # (W, 9, 2)
    offsets = xy - xy[:, :1]
    u = offsets[:, -1] / np.maximum(np.hypot(*offsets[:, -1].T), 1e-12)[:, None]
    normal = np.stack([-u[:, 1], u[:, 0]], axis=1)
    sigma, along = (s[rows, ball[:, None]].mean(axis=1) for s in (tracks.sigma, tracks.sigma_along))
    return _MotionWindows(rows, (offsets @ u[..., None])[..., 0], along, (offsets @ normal[..., None])[..., 0], sigma)


def _find_steady_runs(tracks: Tracks) -> tuple[IntArray, IntArray]:
    """Find balls (W,) and frame indices (W, 9) of the windows."""
    balls, windows = [], []
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        for first in range(len(rows) - WINDOW + 1):
            part = rows[first : first + WINDOW]
            if part[-1] - part[0] <= 2 * WINDOW and _moves_steadily(
                tracks.xy[part, ball], tracks.sigma_along[part, ball]
            ):
                balls.append(ball)
                windows.append(part)
    return np.array(balls, dtype=np.int64), np.array(windows, dtype=np.int64).reshape(-1, WINDOW)


def _moves_steadily(xy: FloatArray, sigma: FloatArray) -> bool:
    """Return whether samples xy (9, 2) m advance from each to the next, straight and without start or stop."""
    steps = np.diff(xy, axis=0)
    length, whole = np.hypot(*steps.T), xy[-1] - xy[0]
    if length.min() < MIN_STEP_SIGMAS * float(sigma.max()) or length.max() > MAX_STEP_RATIO * length.min():
        return False
    straight = steps @ whole / np.maximum(length * float(np.hypot(*whole)), 1e-12)
    return bool(straight.min() > MIN_COSINE)


def _rescale_sigmas(windows: _MotionWindows, t: FloatArray, floor: float) -> _MotionWindows:
    """Rescale sigmas to the scatter across the path, which no clock affects."""
    residual_operator, _ = _fit_parabolas(t[windows.row], np.full(len(windows.row), np.inf))
    chi2 = _quadratic_form(residual_operator, windows.across) / windows.sigma_across**2
    factor = np.sqrt(max(float(np.median(chi2)) / _CHI2_MEDIAN, 1e-4))
    return replace(windows, sigma=np.hypot(windows.sigma * factor, floor))


def _fit_parabolas(t: FloatArray, acceleration_ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Q (W, 9, 9) and D (W, 9, 9) for samples x at t (W, 9) on a parabola through them.

    x Q x is the sum of the squared residuals and of the normalized acceleration; D x are velocities.
    `acceleration_ratio` (W,) is the standard deviation of the acceleration over that of a sample, 1/s^2.
    """
    tau = t - t[:, WINDOW // 2, None]
    one = np.ones_like(tau)
    basis = np.stack([one, tau, tau**2 / 2], axis=-1)  # (W, 9, 3)
    transposed = np.swapaxes(basis, 1, 2)
    normal = transposed @ basis
    normal[:, 2, 2] += acceleration_ratio**-2.0
    solved = np.linalg.solve(normal, transposed)
    residual_operator: FloatArray = np.eye(WINDOW) - basis @ solved
    return residual_operator, np.stack([0 * one, one, tau], axis=-1) @ solved


def _window_chi2(windows: _MotionWindows, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate the chi2 of each window (W,) at capture times t (T,), and the matrices of `_fit_parabolas`."""
    residual_operator, velocity_operator = _fit_parabolas(t[windows.row], ACCELERATION / windows.sigma)
    return _quadratic_form(residual_operator, windows.along) / windows.sigma**2, residual_operator, velocity_operator


def _quadratic_form(matrix: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray((x[:, None] @ matrix @ x[..., None])[:, 0, 0])


def _robust_misfit(windows: _MotionWindows, t: FloatArray, soft_limit: float = SOFT_CHI2) -> float:
    """Evaluate the robust chi2 of all windows: none adds more than `soft_limit` (Geman, McClure 1985)."""
    return INDEPENDENT_SHARE * float(_soften_chi2(_window_chi2(windows, t)[0], soft_limit).sum())


def _soften_chi2(chi2: FloatArray, soft_limit: float = SOFT_CHI2) -> FloatArray:
    softened: FloatArray = chi2 / (1 + chi2 / soft_limit)
    return softened


def _estimate_cadence(windows: _MotionWindows, t: FloatArray, interval: float) -> FloatArray:
    """Estimate times (T,) of frames taken regularly, some dropped or held, at the same rate on average."""
    best, unchanged = t, _robust_misfit(windows, t)
    best_gain, dof = MIN_CLOCK_GAIN, INDEPENDENT_SHARE * WINDOW_DOF * len(windows.row)
    for capture in _candidate_cadences(t, interval):
        misfit = _robust_misfit(windows, capture)
        gain = (unchanged - misfit) / max(misfit / dof, 1.0)
        if gain > best_gain:
            best, best_gain = capture, gain
    return best


def _candidate_cadences(t: FloatArray, interval: float) -> Iterator[FloatArray]:
    """Yield times (T,) of regularly taken frames that rate conversions would present at t (T,)."""
    yield from _even_times(t, interval)
    shown = np.round((t - t[0]) / interval).astype(np.int64)
    for every in range(2, LONGEST_CADENCE + 1):
        for phase in range(every):
            number = shown + (shown - phase) // every
            yield t[0] + (number - number[0]) * interval * every / (every + 1)


def _even_times(t: FloatArray, interval: float) -> list[FloatArray]:
    """Return even times (T,) where t (T,) is not.

    Duplicates were left out, or frames are held for two or three intervals.
    """
    order = np.arange(len(t))
    uneven = np.any(np.round((t - t[0]) / interval) != order)
    return [t[0] + order * (t[-1] - t[0]) / (len(t) - 1)] if uneven else []


def _insert_losses(windows: _MotionWindows, t: FloatArray, interval: float) -> list[FloatArray]:
    """Return times (T,) unchanged, and with lost frames where the windows across such a gap show them."""
    options, capture = [t], t
    for _ in range(len(t)):
        base = _soften_chi2(_window_chi2(windows, capture)[0])
        trials = [(_evaluate_loss(windows, capture, base, row, lost * interval), row, lost * interval)
                 for row in _find_torn_frames(windows, base) for lost in range(1, MAX_LOST_FRAMES + 1)]  # fmt: skip
        gain, row, pause = max(trials, default=(0.0, 0, 0.0))
        if gain < MIN_CLOCK_GAIN:
            break
        capture = _insert_pause(capture, row, pause)
        options = [t, capture]
    return options


def _find_torn_frames(windows: _MotionWindows, base: FloatArray) -> list[int]:
    """Find the frames after which most windows fit badly."""
    frames = []
    for row in np.unique(windows.row[:, :-1]):
        spans_gap = (windows.row[:, 0] <= row) & (row < windows.row[:, -1])
        if base[spans_gap].mean() > SOFT_CHI2 / 3:
            frames.append(int(row))
    return frames


def _evaluate_loss(windows: _MotionWindows, t: FloatArray, base: FloatArray, row: int, pause: float) -> float:
    """Evaluate the robust chi2 that a pause, s, after a frame explains."""
    spans_gap = (windows.row[:, 0] <= row) & (row < windows.row[:, -1])
    after = _soften_chi2(_window_chi2(windows.select_windows(spans_gap), _insert_pause(t, row, pause))[0])
    return INDEPENDENT_SHARE * float((base[spans_gap] - after).sum()) / max(float(after.mean()) / WINDOW_DOF, 1.0)


def _insert_pause(t: FloatArray, row: int, pause: float) -> FloatArray:
    """Delay all frames after a row by a pause, s."""
    delayed = t.copy()
    delayed[row + 1 :] += pause
    return delayed


def _estimate_jitter(windows: _MotionWindows, t: FloatArray, interval: float) -> tuple[float, FloatArray, FloatArray]:
    """Estimate the most probable jitter about t (T,): log evidence, times (T,) and their sigmas, 0 without jitter."""
    options = [(-_robust_misfit(windows, t) / 2, t, np.zeros(len(t)))]
    for share in JITTERS:
        spread = share * interval
        capture, information = _optimize_times(windows, t, spread)
        deviation = (capture - t) / spread
        _, log_volume = np.linalg.slogdet(np.eye(len(t)) + spread**2 * information)
        sigma = np.sqrt(np.diag(np.linalg.inv(information + np.eye(len(t)) / spread**2)))
        options.append(
            (
                -_robust_misfit(windows, capture) / 2 - float(deviation @ deviation) / 2 - float(log_volume) / 2,
                capture,
                sigma,
            )
        )
    return max(options, key=lambda option: option[0])


def _optimize_times(windows: _MotionWindows, t: FloatArray, spread: float) -> tuple[FloatArray, FloatArray]:
    """Optimize times (T,) with a prior of `spread` s about t (T,), and return their information (T, T)."""
    capture, least = t, 0.1 * float(np.diff(t).min())
    for step in range(MAX_STEPS):
        chi2, residual_operator, velocity_operator = _window_chi2(windows, capture)
        soft_limit = SOFT_CHI2 * (max(float(np.median(chi2)), 1.0) if step < ANNEALING_STEPS else 1.0)
        information, slope = _build_normal_equations(
            windows, residual_operator, velocity_operator, INDEPENDENT_SHARE / (1 + chi2 / soft_limit) ** 2, len(t)
        )
        move = np.linalg.solve(information + np.eye(len(t)) / spread**2, slope + (capture - t) / spread**2)
        here = _jitter_cost(windows, capture, t, spread, soft_limit)
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = capture - share * move
            if np.diff(trial).min() > least and _jitter_cost(windows, trial, t, spread, soft_limit) < here:
                capture = trial
                break
    return capture, information


def _jitter_cost(
    windows: _MotionWindows, capture: FloatArray, t: FloatArray, spread: float, soft_limit: float
) -> float:
    deviation = (capture - t) / spread
    return _robust_misfit(windows, capture, soft_limit) + float(deviation @ deviation)


def _build_normal_equations(
    windows: _MotionWindows, residual_operator: FloatArray, velocity_operator: FloatArray, weight: FloatArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """Evaluate half the second and first derivatives of the weighted chi2 by the times (T, T), (T,)."""
    residual, speed = (
        (matrix @ windows.along[..., None])[..., 0] for matrix in (residual_operator, velocity_operator)
    )  # (W, 9) m, m/s
    scale = weight / windows.sigma**2
    gradient, information = np.zeros(size), np.zeros((size, size))
    np.add.at(gradient, windows.row, -scale[:, None] * residual * speed)
    block = scale[:, None, None] * speed[:, :, None] * residual_operator * speed[:, None, :]
    np.add.at(information, (windows.row[:, :, None], windows.row[:, None, :]), block)
    return information, gradient
