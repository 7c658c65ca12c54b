"""How noisy tracks are, told from the tracks alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.typing import FloatArray

_MAD = 1.4826
"""Median absolute deviation to standard deviation, normal distribution."""
_ENOUGH = 20
"""Values that a median needs to be trusted."""
_BURST = 25
"""Samples over which bursts of noise are judged; a contact disturbs four of them."""
_CALM, _CALM_NORMAL = 0.25, 0.3186
"""Quantile that tells the noise of a burst in spite of four contacts, and its value for a standard normal."""


SELDOM = 0.5
"""share of the pictures of its life: real balls are missed less, hands and cues more."""
EVEN = 0.4
"""Least of three successive steps over their mean, of a ball that gets on."""
FLOOR = 0.012
"""ball radii: errors that do not average out (calibration, lens, shading), however sharp the picture."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What to make of the sigmas of tracks."""

    scale: FloatArray
    """(N,) factor on the sigmas of each ball."""
    timing: FloatArray
    """(T,) s: jitter of the moments at which pictures were taken; it moves fast balls along their way."""
    floor: float
    """m, added in quadrature."""
    bursts: FloatArray
    """(T, N, 2) >= 1: further factors along and across the motion where a ball is seen badly for a while."""


@dataclass(frozen=True, slots=True)
class _Misfit:
    """What no parabola explains in every four successive samples of the balls, M values each.

    Seen in the picture (`Tracks.as_seen`), where an oblique view has no worse direction.
    """

    along: FloatArray
    """m, in the direction of motion."""
    across: FloatArray
    sigma: FloatArray
    """m, standard deviation that the tracks promise, across and along."""
    sigma_along: FloatArray
    speed: FloatArray
    """m/s on the table; 0 where the ball does not get on evenly, as one does not that jumps between two places."""
    pace: FloatArray
    """m/s as seen."""


_FIELDS = ("along", "across", "sigma", "sigma_along", "speed", "pace")


def estimate_noise(tracks: Tracks, speed: float, radius: float) -> Noise:
    """From third differences of balls that move faster than `speed` (m/s).

    Moving balls count where there are enough of them: a compressed still picture repeats its errors, so that balls
    at rest look too good. Where there is nothing to tell it from, the tracks are believed. Balls with too few samples
    take what the best seen ones show.
    """
    balls = [_misfit(tracks, ball) for ball in range(len(tracks.ids))]
    seen = tracks.observed.sum(axis=0)
    best = [ball for ball, count in zip(balls, seen, strict=True) if count >= 0.6 * seen.max()]
    reference = _Misfit(*(np.concatenate([getattr(b, name) for b in best] or [np.empty(0)]) for name in _FIELDS))
    together = _scale(reference, speed)
    own = np.array([_scale(ball, speed) for ball in balls])
    scale = np.where(np.isfinite(own), np.fmax(own, 0.7 * together), together)
    scale = np.clip(np.where(np.isfinite(scale), scale, 1.0), 1 / 3, 10.0)
    usual = float(np.clip(together, 1 / 3, 10.0)) if np.isfinite(together) else 1.0
    bursts = np.ones((len(tracks.t), len(tracks.ids), 2))
    for ball, miss in enumerate(balls):
        rows = np.flatnonzero(tracks.observed[:, ball])
        if len(rows) >= _BURST:
            bursts[rows, ball] = _bursts(miss, float(scale[ball]))
    timing = np.full(len(tracks.t), _timing(reference, speed, usual))
    return Noise(scale, timing, FLOOR * radius, bursts)


def _scale(miss: _Misfit, speed: float) -> float:
    """Noise over sigma across the motion, of balls at rest in both directions; NaN where there are too few samples."""
    fast = miss.speed > speed
    across, along = np.abs(miss.across) / miss.sigma, np.abs(miss.along) / miss.sigma_along
    if fast.sum() >= _ENOUGH:
        return _MAD * float(np.median(across[fast]))
    if (~fast).sum() >= _ENOUGH:
        # pictures of a ball at rest share most of their error, which its stated sigma holds and differences do not show
        return max(_MAD * float(np.median(np.concatenate([across[~fast], along[~fast]]))), 1.0)
    return float("nan")


def _bursts(miss: _Misfit, scale: float) -> FloatArray:
    """How much more than usual the samples (n, 2) scatter around their moment, along and across the motion; >= 1."""
    values = np.abs(np.stack([miss.along / miss.sigma_along, miss.across / miss.sigma], axis=1)) / scale
    padded = np.pad(values, ((_BURST // 2, _BURST // 2), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _BURST, axis=0)
    local = np.quantile(windows, _CALM, axis=-1) / _CALM_NORMAL  # (n-3, 2)
    at_samples = np.concatenate([local[:1], (local[:-2] + local[1:-1]) / 2, local[-2:], local[-1:]])[: len(values) + 3]
    spread = np.concatenate([at_samples, np.repeat(at_samples[-1:], len(values) + 3 - len(at_samples), axis=0)])
    return np.clip(np.where(spread > 1.8, spread, 1.0), 1.0, 30.0)


def _timing(miss: _Misfit, speed: float, scale: float) -> float:
    """What the faster half scatters along its way beyond `scale` times the sigmas, over its speed, s."""
    fast = miss.speed > speed
    if fast.sum() < _ENOUGH / 2:
        return 0.0
    fast &= miss.speed >= np.median(miss.speed[fast])
    spread = _MAD * float(np.median(np.abs(miss.along[fast]) / miss.pace[fast]))
    known = scale * float(np.median(miss.sigma_along[fast] / miss.pace[fast]))
    return float(np.sqrt(max(spread**2 - known**2, 0.0)))


def with_noise(tracks: Tracks, noise: Noise) -> Tracks:
    """Tracks whose sigmas say what the samples show; where time jitters, `streak` gives the direction of motion."""
    sigma = np.hypot(tracks.sigma * noise.scale * noise.bursts[..., 1], noise.floor)
    along, streak = np.hypot(tracks.sigma_along * noise.scale, noise.floor), tracks.streak.copy()
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        if len(rows) < 2:
            continue
        v = velocities(tracks.t[rows], tracks.xy[rows, ball])
        lay = None if tracks.lay is None else tracks.lay[rows, ball]
        shake = np.hypot(*_as_seen(v, lay).T) * noise.timing[rows]
        known = tracks.sigma_along[rows, ball] * noise.scale[ball]
        along[rows, ball] = np.fmax(np.hypot(along[rows, ball], shake), known * noise.bursts[rows, ball, 0])
        streak[rows, ball] = np.where(np.hypot(*v.T)[:, None] > 0, v * 1e-3, streak[rows, ball])
    return replace(tracks, sigma=sigma, sigma_along=along, streak=streak)


def velocities(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Central differences (T, 2) of xy (T, 2) at t (T,), one-sided at the ends."""
    before, after = np.clip(np.arange(len(t)) - 1, 0, None), np.clip(np.arange(len(t)) + 1, None, len(t) - 1)
    return (xy[after] - xy[before]) / (t[after] - t[before])[:, None]


def _misfit(tracks: Tracks, ball: int) -> _Misfit:
    """Divided differences of third order, so that times may be irregular."""
    rows = np.flatnonzero(tracks.observed[:, ball])
    if len(rows) < 4:
        return _Misfit(*(np.empty(0) for _ in _FIELDS))
    t, xy = tracks.t[rows], tracks.xy[rows, ball]
    window = np.lib.stride_tricks.sliding_window_view(t, 4)  # (T-3, 4)
    gaps = window[:, :, None] - window[:, None, :]
    gaps[:, np.arange(4), np.arange(4)] = 1.0
    weight = 1 / gaps.prod(axis=2)
    weight /= np.linalg.norm(weight, axis=1)[:, None]
    miss = np.einsum("tk,tdk->td", weight, np.lib.stride_tricks.sliding_window_view(xy, 4, axis=0))
    steps = np.lib.stride_tricks.sliding_window_view(np.linalg.norm(np.diff(xy, axis=0), axis=1), 3)  # (T-3, 3)
    lay = None if tracks.lay is None else tracks.lay[rows[1:-2], ball]
    even = steps.min(axis=1) > EVEN * steps.mean(axis=1)
    speed = even * np.linalg.norm(xy[3:] - xy[:-3], axis=1) / (t[3:] - t[:-3])
    miss, way = _as_seen(miss, lay), _as_seen(xy[3:] - xy[:-3], lay)
    length = np.linalg.norm(way, axis=1)
    direction = np.where(length[:, None] > 0, way / np.maximum(length, 1e-12)[:, None], np.array([1.0, 0.0]))
    sigma, along = (
        np.sqrt((weight**2 * np.lib.stride_tricks.sliding_window_view(s[rows, ball], 4) ** 2).sum(axis=1))
        for s in (tracks.sigma, tracks.sigma_along)
    )
    across = miss[:, 1] * direction[:, 0] - miss[:, 0] * direction[:, 1]
    return _Misfit((miss * direction).sum(axis=1), across, sigma, along, speed, length / (t[3:] - t[:-3]))


def _as_seen(vectors: FloatArray, lay: FloatArray | None) -> FloatArray:
    """Vectors (n, 2) on the table as the picture shows them, which lies on it as `lay` (n, 2, 2) says."""
    return vectors if lay is None else np.asarray(np.linalg.solve(lay, vectors[..., None])[..., 0])


def seldom_seen(tracks: Tracks) -> NDArray[np.bool_]:
    """(N,) balls seen in fewer than three pictures, or in less than half of those of their life."""
    seldom = np.zeros(len(tracks.ids), bool)
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        seldom[ball] = len(rows) < 3 or len(rows) < SELDOM * (rows[-1] - rows[0] + 1)
    return seldom


def outliers(t: FloatArray, xy: FloatArray, sigma: FloatArray, limit: float = 8.0) -> NDArray[np.bool_]:
    """Samples (T,) that lie far off while the two before and the two after agree with each other without them.

    They agree where a ball goes on steadily, and where it rests on one side and is at that place on the other: none
    leaves a place and is back there in the next picture. `limit` is in standard deviations of the sample.
    """
    bad = np.zeros(len(t), bool)
    if len(t) < 5:
        return bad
    left, right = xy[1:-3], xy[3:-1]
    share = ((t[2:-2] - t[1:-3]) / (t[3:-1] - t[1:-3]))[:, None]
    jump = np.linalg.norm(xy[2:-2] - (left + share * (right - left)), axis=1)
    gaps = [(late - early)[:, None] for early, late in ((t[:-4], t[1:-3]), (t[1:-3], t[3:-1]), (t[3:-1], t[4:]))]
    ways = (left - xy[:-4], right - left, xy[4:] - right)
    before, pace, after = (way / gap for way, gap in zip(ways, gaps, strict=True))
    left_by, step, goes_on = (np.linalg.norm(way, axis=1) for way in ways)
    usual = (np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1)) / 2
    # neither faster or slower than before and after, nor another way
    change = np.linalg.norm(pace - (before + after) / 2, axis=1) + usual - np.linalg.norm(before + after, axis=1) / 2
    steady = change < 0.2 * usual + 2 * sigma[2:-2] / gaps[1][:, 0]
    steady &= np.linalg.norm(after - before, axis=1) < usual + 2 * sigma[2:-2] / gaps[1][:, 0]
    near = 3 * np.maximum(sigma[1:-3], sigma[3:-1])
    rested = np.minimum(left_by, goes_on) < near
    # a contact bends a path by at most what the ball can travel meanwhile
    bad[2:-2] = (steady | (rested & (step < near))) & (jump > limit * sigma[2:-2]) & (jump > 0.5 * step)
    return bad
