"""When pictures were really taken: containers show them at even times, conversions and cameras take them at others.

A conversion from 30 to 25 pictures a second drops every sixth one, a recording of a screen keeps pictures as they come,
a busy camera loses some. Everything that moves then jumps or lags *together*, which no contact does, and along its way
only. So short windows of all moving balls are fitted by parabolas of a common time; across the way they tell the noise,
along it the clock. Pictures are taken as the container says unless the evidence for another clock is strong (empirical
Bayes: MacKay 1992, doi:10.1162/neco.1992.4.3.415).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.capture_clock import Clock
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray

WINDOW = 9
"""samples that share a parabola: fewer let the clock drift within a few windows, more are cut by contacts."""
FREE = WINDOW - 3.0
"""Degrees of freedom of a window: a robust chi2 beyond says that something else is wrong, and counts for less."""
OVERLAP = 1 / FREE
"""Share of a window's misfit that is news: each sample is in nine windows."""
ACCELERATION = 2.0
"""m/s^2, prior standard deviation along the way: sliding friction."""
STEADY_STEP = 4.0
"""standard deviations that a ball moves from sample to sample, at least: a slower one tells no time."""
STRAIGHT = 0.94
"""Least cosine between a step and the whole way of a window: contacts turn, clocks do not."""
MOST_UNEVEN = 8.0
"""Longest over shortest step: beyond, the ball was struck or stopped."""
WORST = 75.0
"""chi2 of a window that counts half: contacts along the way are none of the clock's business."""
LONGEST_CADENCE = 12
"""pictures from one dropped picture to the next: 30 to 25 a second drops one after five, 24 to 23 one after 23."""
LEAST_GAIN = 30.0
"""chi2 that another clock must explain, whatever its numbers: a window or two may be wrong."""
MOST_LOST = 3
"""pictures lost at once."""
JITTERS = (0.05, 0.15, 0.4)
"""picture intervals: standard deviations of the times that are tried."""
_MEDIAN = 5.348
"""of chi2 with six degrees of freedom."""
STEPS, ANNEALED = 12, 4
"""of the descent; during the first of them windows are believed that fit badly."""


@dataclass(frozen=True, slots=True)
class _Windows:
    """W runs of `WINDOW` successive samples of a ball on its way."""

    row: IntArray
    """(W, 9) pictures."""
    way: FloatArray
    """(W, 9) m along the mean direction."""
    sigma: FloatArray
    """(W,) m, one standard deviation along the way."""
    across: FloatArray
    """(W, 9) m, beside it."""
    sigma_across: FloatArray
    """(W,) m."""

    def part(self, rows: NDArray[np.bool_]) -> _Windows:
        """Some of them."""
        return _Windows(*(getattr(self, name)[rows] for name in ("row", "way", "sigma", "across", "sigma_across")))


def clock_of(tracks: Tracks, floor: float) -> Clock:
    """The clock that the motion of all balls together tells; the container's where that explains it.

    `floor` is the error of a sample that does not average out, m.
    """
    shown = Clock(tracks.t, tracks.t, np.zeros(len(tracks.t)))
    windows = _windows(tracks)
    if len(tracks.t) < 2 * WINDOW or len(windows.row) < WINDOW:
        return shown
    interval = float(np.median(np.diff(tracks.t)))
    windows = _scaled(windows, tracks.t, floor)
    bases = [_cadence(windows, tracks.t, interval), *_even(tracks.t, interval)]
    ways = [t for base in bases for t in _with_losses(windows, base, interval)]
    best, taken, sigma = max((_jittered(windows, t, interval) for t in ways), key=lambda way: way[0])
    plain = -_misfit(windows, tracks.t) / 2
    return Clock(tracks.t, taken, sigma) if best - plain > LEAST_GAIN / 2 else shown


def _windows(tracks: Tracks) -> _Windows:
    """Where balls go on steadily enough to tell the time."""
    ball, rows = _steady(tracks)
    xy = tracks.xy[rows, ball[:, None]]  # (W, 9, 2)
    off = xy - xy[:, :1]
    u = off[:, -1] / np.maximum(np.hypot(*off[:, -1].T), 1e-12)[:, None]
    beside = np.stack([-u[:, 1], u[:, 0]], axis=1)
    sigma, along = (s[rows, ball[:, None]].mean(axis=1) for s in (tracks.sigma, tracks.sigma_along))
    return _Windows(rows, (off @ u[..., None])[..., 0], along, (off @ beside[..., None])[..., 0], sigma)


def _steady(tracks: Tracks) -> tuple[IntArray, IntArray]:
    """Balls (W,) and pictures (W, 9) of the windows."""
    balls, windows = [], []
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        for first in range(len(rows) - WINDOW + 1):
            part = rows[first : first + WINDOW]
            if part[-1] - part[0] <= 2 * WINDOW and _goes_on(tracks.xy[part, ball], tracks.sigma_along[part, ball]):
                balls.append(ball)
                windows.append(part)
    return np.array(balls, dtype=np.int64), np.array(windows, dtype=np.int64).reshape(-1, WINDOW)


def _goes_on(xy: FloatArray, sigma: FloatArray) -> bool:
    """Whether samples xy (9, 2) m get on from each to the next, straight and without starting or stopping."""
    steps = np.diff(xy, axis=0)
    length, whole = np.hypot(*steps.T), xy[-1] - xy[0]
    if length.min() < STEADY_STEP * float(sigma.max()) or length.max() > MOST_UNEVEN * length.min():
        return False
    straight = steps @ whole / np.maximum(length * float(np.hypot(*whole)), 1e-12)
    return bool(straight.min() > STRAIGHT)


def _scaled(windows: _Windows, t: FloatArray, floor: float) -> _Windows:
    """The windows with sigmas as the samples scatter across the way, where no clock shows."""
    left, _ = _left_over(t[windows.row], np.full(len(windows.row), np.inf))
    chi2 = _quadratic(left, windows.across) / windows.sigma_across**2
    factor = np.sqrt(max(float(np.median(chi2)) / _MEDIAN, 1e-4))
    return replace(windows, sigma=np.hypot(windows.sigma * factor, floor))


def _left_over(t: FloatArray, bend: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Q (W, 9, 9) and D (W, 9, 9) for samples x at t (W, 9) on a parabola through them.

    x Q x is the sum of the squares of what it misses, and of its bend; D x are its velocities. `bend` (W,) is the
    standard deviation of the acceleration over that of a sample, 1/s^2.
    """
    tau = t - t[:, WINDOW // 2, None]
    one = np.ones_like(tau)
    basis = np.stack([one, tau, tau**2 / 2], axis=-1)  # (W, 9, 3)
    turned = np.swapaxes(basis, 1, 2)
    normal = turned @ basis
    normal[:, 2, 2] += bend**-2.0
    solved = np.linalg.solve(normal, turned)
    left: FloatArray = np.eye(WINDOW) - basis @ solved
    return left, np.stack([0 * one, one, tau], axis=-1) @ solved


def _chi2(windows: _Windows, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each window (W,) at times t (T,) of the pictures, and `_left_over`."""
    left, pace = _left_over(t[windows.row], ACCELERATION / windows.sigma)
    return _quadratic(left, windows.way) / windows.sigma**2, left, pace


def _quadratic(matrix: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray((x[:, None] @ matrix @ x[..., None])[:, 0, 0])


def _misfit(windows: _Windows, t: FloatArray, worst: float = WORST) -> float:
    """Robust chi2 of all windows: none adds more than `worst` (Geman, McClure 1985)."""
    return OVERLAP * float(_soft(_chi2(windows, t)[0], worst).sum())


def _soft(chi2: FloatArray, worst: float = WORST) -> FloatArray:
    soft: FloatArray = chi2 / (1 + chi2 / worst)
    return soft


def _cadence(windows: _Windows, t: FloatArray, interval: float) -> FloatArray:
    """Times (T,) of the pictures if they were taken regularly and some dropped or held, at the same rate on average."""
    best, plain = t, _misfit(windows, t)
    most, dof = LEAST_GAIN, OVERLAP * FREE * len(windows.row)
    for taken in _regular(t, interval):
        left = _misfit(windows, taken)
        gain = (plain - left) / max(left / dof, 1.0)
        if gain > most:
            best, most = taken, gain
    return best


def _regular(t: FloatArray, interval: float) -> Iterator[FloatArray]:
    """Times (T,) of pictures that were taken regularly, as conversions of the rate would show them at t (T,)."""
    yield from _even(t, interval)
    shown = np.round((t - t[0]) / interval).astype(np.int64)
    for every in range(2, LONGEST_CADENCE + 1):
        for phase in range(every):
            number = shown + (shown - phase) // every
            yield t[0] + (number - number[0]) * interval * every / (every + 1)


def _even(t: FloatArray, interval: float) -> list[FloatArray]:
    """Even times (T,) where t (T,) is not: repeats were left out, or pictures are held for two intervals and three."""
    order = np.arange(len(t))
    uneven = np.any(np.round((t - t[0]) / interval) != order)
    return [t[0] + order * (t[-1] - t[0]) / (len(t) - 1)] if uneven else []


def _with_losses(windows: _Windows, t: FloatArray, interval: float) -> list[FloatArray]:
    """Times (T,) as they are, and with pictures lost here and there, where the windows across such a gap ask for it."""
    ways, taken = [t], t
    for _ in range(len(t)):
        base = _soft(_chi2(windows, taken)[0])
        tries = [(_gain_of_loss(windows, taken, base, row, lost * interval), row, lost * interval)
                 for row in _torn(windows, base) for lost in range(1, MOST_LOST + 1)]  # fmt: skip
        gain, row, pause = max(tries, default=(0.0, 0, 0.0))
        if gain < LEAST_GAIN:
            break
        taken = _paused(taken, row, pause)
        ways = [t, taken]
    return ways


def _torn(windows: _Windows, base: FloatArray) -> list[int]:
    """Pictures after which most windows fit badly."""
    found = []
    for row in np.unique(windows.row[:, :-1]):
        across = (windows.row[:, 0] <= row) & (row < windows.row[:, -1])
        if base[across].mean() > WORST / 3:
            found.append(int(row))
    return found


def _gain_of_loss(windows: _Windows, t: FloatArray, base: FloatArray, row: int, pause: float) -> float:
    """Robust chi2 that a pause of so many s after a picture explains."""
    across = (windows.row[:, 0] <= row) & (row < windows.row[:, -1])
    after = _soft(_chi2(windows.part(across), _paused(t, row, pause))[0])
    return OVERLAP * float((base[across] - after).sum()) / max(float(after.mean()) / FREE, 1.0)


def _paused(t: FloatArray, row: int, pause: float) -> FloatArray:
    later = t.copy()
    later[row + 1 :] += pause
    return later


def _jittered(windows: _Windows, t: FloatArray, interval: float) -> tuple[float, FloatArray, FloatArray]:
    """Log evidence of the likeliest jitter about t (T,), the times (T,) and their sigmas; none where none is needed."""
    ways = [(-_misfit(windows, t) / 2, t, np.zeros(len(t)))]
    for share in JITTERS:
        spread = share * interval
        taken, information = _descended(windows, t, spread)
        off = (taken - t) / spread
        _, volume = np.linalg.slogdet(np.eye(len(t)) + spread**2 * information)
        sigma = np.sqrt(np.diag(np.linalg.inv(information + np.eye(len(t)) / spread**2)))
        ways.append((-_misfit(windows, taken) / 2 - float(off @ off) / 2 - float(volume) / 2, taken, sigma))
    return max(ways, key=lambda way: way[0])


def _descended(windows: _Windows, t: FloatArray, spread: float) -> tuple[FloatArray, FloatArray]:
    """Times (T,) that fit the windows best, `spread` s about t (T,), and what the windows say of them (T, T)."""
    taken, least = t, 0.1 * float(np.diff(t).min())
    for step in range(STEPS):
        chi2, left, pace = _chi2(windows, taken)
        worst = WORST * (max(float(np.median(chi2)), 1.0) if step < ANNEALED else 1.0)
        information, slope = _normal(windows, left, pace, OVERLAP / (1 + chi2 / worst) ** 2, len(t))
        move = np.linalg.solve(information + np.eye(len(t)) / spread**2, slope + (taken - t) / spread**2)
        here = _jitter_cost(windows, taken, t, spread, worst)
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = taken - share * move
            if np.diff(trial).min() > least and _jitter_cost(windows, trial, t, spread, worst) < here:
                taken = trial
                break
    return taken, information


def _jitter_cost(windows: _Windows, taken: FloatArray, t: FloatArray, spread: float, worst: float) -> float:
    off = (taken - t) / spread
    return _misfit(windows, taken, worst) + float(off @ off)


def _normal(
    windows: _Windows, left: FloatArray, pace: FloatArray, weight: FloatArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """Half the second and first derivatives of the weighted chi2 by the times (T, T), (T,)."""
    rest, speed = ((matrix @ windows.way[..., None])[..., 0] for matrix in (left, pace))  # (W, 9) m, m/s
    scale = weight / windows.sigma**2
    gradient, information = np.zeros(size), np.zeros((size, size))
    np.add.at(gradient, windows.row, -scale[:, None] * rest * speed)
    block = scale[:, None, None] * speed[:, :, None] * left * speed[:, None, :]
    np.add.at(information, (windows.row[:, :, None], windows.row[:, None, :]), block)
    return information, gradient
