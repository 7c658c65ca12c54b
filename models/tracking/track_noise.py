"""Measurement noise of tracks, estimated from the tracks alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.typing import FloatArray

# Median absolute deviation to standard deviation, normal distribution.
_MAD_TO_SIGMA = 1.4826
# Least number of values for a reliable median.
_MIN_VALUES = 20
# Samples over which local noise is estimated; a contact disturbs four of them.
_LOCAL_WINDOW = 25
# Quantile that estimates local noise in spite of four contacts, and its value for a standard normal.
_LOCAL_QUANTILE, _NORMAL_QUANTILE = 0.25, 0.3186


# Least share of the frames of its life with a detection: balls are missed less often, hands and cues more.
MIN_DETECTED_SHARE = 0.5
# Least of three successive steps over their mean, of a ball that moves on.
MIN_STEP_RATIO = 0.4
# Ball radii: errors that do not average out (calibration, lens, shading), however sharp the image.
NOISE_FLOOR_RADII = 0.012


@dataclass(frozen=True, slots=True)
class TrackNoise:
    """Corrections of the sigmas of N tracks over T frames."""

    scale: FloatArray
    """(N,) factor on the sigmas of each ball."""
    timing: FloatArray
    """(T,) s: jitter of the capture times; it moves fast balls along their path."""
    floor: float
    """m, added in quadrature."""
    local_scale: FloatArray
    """(T, N, 2) >= 1: further factors along and across the motion where a ball is detected badly for a while."""


@dataclass(frozen=True, slots=True)
class _DifferenceResiduals:
    """Residuals of a parabola through every four successive samples of the balls, M values each.

    Evaluated in the image plane (`Tracks.map_to_image`), where an oblique view has no worse direction.
    """

    along: FloatArray
    """m, in the direction of motion."""
    across: FloatArray
    sigma: FloatArray
    """m, standard deviation by the sigmas of the tracks, across and along."""
    sigma_along: FloatArray
    speed: FloatArray
    """m/s on the table; 0 where the ball does not move on evenly, e.g. where a track jumps between two places."""
    pace: FloatArray
    """m/s in the image plane."""


_FIELDS = ("along", "across", "sigma", "sigma_along", "speed", "pace")


def estimate_noise(tracks: Tracks, speed: float, radius: float) -> TrackNoise:
    """Estimate the measurement noise of tracks from third differences.

    Moving balls decide where there are enough of them: compression repeats the errors of a still image, so that balls
    at rest look too precise. Without enough samples the sigmas stay. Balls with too few samples take the noise of the
    best observed ones.

    Args:
        tracks: Tracks of N balls over T frames.
        speed: Speed above which a ball counts as moving, m/s.
        radius: Ball radius, m.

    Returns:
        Factors on the sigmas, jitter of the capture times and the noise floor.
    """
    balls = [_third_differences(tracks, ball) for ball in range(len(tracks.ids))]
    counts = tracks.is_observed.sum(axis=0)
    best = [ball for ball, count in zip(balls, counts, strict=True) if count >= 0.6 * counts.max()]
    reference = _DifferenceResiduals(
        *(np.concatenate([getattr(b, name) for b in best] or [np.empty(0)]) for name in _FIELDS)
    )
    pooled_scale = _noise_scale(reference, speed)
    own_scale = np.array([_noise_scale(ball, speed) for ball in balls])
    scale = np.where(np.isfinite(own_scale), np.fmax(own_scale, 0.7 * pooled_scale), pooled_scale)
    scale = np.clip(np.where(np.isfinite(scale), scale, 1.0), 1 / 3, 10.0)
    usual_scale = float(np.clip(pooled_scale, 1 / 3, 10.0)) if np.isfinite(pooled_scale) else 1.0
    local_scale = np.ones((len(tracks.t), len(tracks.ids), 2))
    for ball, residuals in enumerate(balls):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if len(rows) >= _LOCAL_WINDOW:
            local_scale[rows, ball] = _local_noise_scale(residuals, float(scale[ball]))
    timing = np.full(len(tracks.t), _timing_jitter(reference, speed, usual_scale))
    return TrackNoise(scale, timing, NOISE_FLOOR_RADII * radius, local_scale)


def _noise_scale(residuals: _DifferenceResiduals, speed: float) -> float:
    """Estimate noise over sigma across the motion, for balls at rest in both directions; NaN with too few samples."""
    is_fast = residuals.speed > speed
    across, along = np.abs(residuals.across) / residuals.sigma, np.abs(residuals.along) / residuals.sigma_along
    if is_fast.sum() >= _MIN_VALUES:
        return _MAD_TO_SIGMA * float(np.median(across[is_fast]))
    if (~is_fast).sum() >= _MIN_VALUES:
        # frames of a ball at rest share most of their error, which its sigma includes and differences do not show
        return max(_MAD_TO_SIGMA * float(np.median(np.concatenate([across[~is_fast], along[~is_fast]]))), 1.0)
    return float("nan")


def _local_noise_scale(residuals: _DifferenceResiduals, scale: float) -> FloatArray:
    """Estimate the local excess (n, 2) of the scatter along and across the motion; >= 1."""
    values = (
        np.abs(np.stack([residuals.along / residuals.sigma_along, residuals.across / residuals.sigma], axis=1)) / scale
    )
    padded = np.pad(values, ((_LOCAL_WINDOW // 2, _LOCAL_WINDOW // 2), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _LOCAL_WINDOW, axis=0)
    local = np.quantile(windows, _LOCAL_QUANTILE, axis=-1) / _NORMAL_QUANTILE  # (n-3, 2)
    at_samples = np.concatenate([local[:1], (local[:-2] + local[1:-1]) / 2, local[-2:], local[-1:]])[: len(values) + 3]
    spread = np.concatenate([at_samples, np.repeat(at_samples[-1:], len(values) + 3 - len(at_samples), axis=0)])
    return np.clip(np.where(spread > 1.8, spread, 1.0), 1.0, 30.0)


def _timing_jitter(residuals: _DifferenceResiduals, speed: float, scale: float) -> float:
    """Estimate the time jitter, s, from the excess scatter of the faster half along its path.

    Excess is what exceeds `scale` times the sigmas.
    """
    is_fast = residuals.speed > speed
    if is_fast.sum() < _MIN_VALUES / 2:
        return 0.0
    is_fast &= residuals.speed >= np.median(residuals.speed[is_fast])
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(residuals.along[is_fast]) / residuals.pace[is_fast]))
    expected = scale * float(np.median(residuals.sigma_along[is_fast] / residuals.pace[is_fast]))
    return float(np.sqrt(max(spread**2 - expected**2, 0.0)))


def apply_noise(tracks: Tracks, noise: TrackNoise) -> Tracks:
    """Replace the sigmas of tracks by the estimated noise.

    Args:
        tracks: Tracks of N balls over T frames.
        noise: Noise of these tracks, from `estimate_noise`.

    Returns:
        The tracks with new `sigma` and `sigma_along`; where time jitters, `streak` has the direction of motion.
    """
    sigma = np.hypot(tracks.sigma * noise.scale * noise.local_scale[..., 1], noise.floor)
    along, streak = np.hypot(tracks.sigma_along * noise.scale, noise.floor), tracks.streak.copy()
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if len(rows) < 2:
            continue
        v = estimate_velocities(tracks.t[rows], tracks.xy[rows, ball])
        lay = None if tracks.image_jacobian is None else tracks.image_jacobian[rows, ball]
        timing_sigma = np.hypot(*_project_to_image(v, lay).T) * noise.timing[rows]
        scaled_along = tracks.sigma_along[rows, ball] * noise.scale[ball]
        along[rows, ball] = np.fmax(
            np.hypot(along[rows, ball], timing_sigma), scaled_along * noise.local_scale[rows, ball, 0]
        )
        streak[rows, ball] = np.where(np.hypot(*v.T)[:, None] > 0, v * 1e-3, streak[rows, ball])
    return replace(tracks, sigma=sigma, sigma_along=along, streak=streak)


def estimate_velocities(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Estimate velocities (T, 2) of xy (T, 2) at t (T,) by central differences, one-sided at the ends."""
    before, after = np.clip(np.arange(len(t)) - 1, 0, None), np.clip(np.arange(len(t)) + 1, None, len(t) - 1)
    return (xy[after] - xy[before]) / (t[after] - t[before])[:, None]


def _third_differences(tracks: Tracks, ball: int) -> _DifferenceResiduals:
    """Evaluate divided differences of third order, so that times may be irregular."""
    rows = np.flatnonzero(tracks.is_observed[:, ball])
    if len(rows) < 4:
        return _DifferenceResiduals(*(np.empty(0) for _ in _FIELDS))
    t, xy = tracks.t[rows], tracks.xy[rows, ball]
    window = np.lib.stride_tricks.sliding_window_view(t, 4)  # (T-3, 4)
    gaps = window[:, :, None] - window[:, None, :]
    gaps[:, np.arange(4), np.arange(4)] = 1.0
    weight = 1 / gaps.prod(axis=2)
    weight /= np.linalg.norm(weight, axis=1)[:, None]
    difference = np.einsum("tk,tdk->td", weight, np.lib.stride_tricks.sliding_window_view(xy, 4, axis=0))
    steps = np.lib.stride_tricks.sliding_window_view(np.linalg.norm(np.diff(xy, axis=0), axis=1), 3)  # (T-3, 3)
    lay = None if tracks.image_jacobian is None else tracks.image_jacobian[rows[1:-2], ball]
    even = steps.min(axis=1) > MIN_STEP_RATIO * steps.mean(axis=1)
    speed = even * np.linalg.norm(xy[3:] - xy[:-3], axis=1) / (t[3:] - t[:-3])
    difference, displacement = _project_to_image(difference, lay), _project_to_image(xy[3:] - xy[:-3], lay)
    length = np.linalg.norm(displacement, axis=1)
    direction = np.where(length[:, None] > 0, displacement / np.maximum(length, 1e-12)[:, None], np.array([1.0, 0.0]))
    sigma, along = (
        np.sqrt((weight**2 * np.lib.stride_tricks.sliding_window_view(s[rows, ball], 4) ** 2).sum(axis=1))
        for s in (tracks.sigma, tracks.sigma_along)
    )
    across = difference[:, 1] * direction[:, 0] - difference[:, 0] * direction[:, 1]
    return _DifferenceResiduals(
        (difference * direction).sum(axis=1), across, sigma, along, speed, length / (t[3:] - t[:-3])
    )


def _project_to_image(vectors: FloatArray, lay: FloatArray | None) -> FloatArray:
    """Transform vectors (n, 2) on the table into the image plane by the inverse of `lay` (n, 2, 2)."""
    return vectors if lay is None else np.asarray(np.linalg.solve(lay, vectors[..., None])[..., 0])


def find_rarely_detected(tracks: Tracks) -> NDArray[np.bool_]:
    """Find balls with fewer than three detections, or with detections in less than half of the frames of their life.

    Args:
        tracks: Tracks of N balls.

    Returns:
        (N,) True for such balls.
    """
    is_rare = np.zeros(len(tracks.ids), bool)
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        is_rare[ball] = len(rows) < 3 or len(rows) < MIN_DETECTED_SHARE * (rows[-1] - rows[0] + 1)
    return is_rare


def find_outliers(t: FloatArray, xy: FloatArray, sigma: FloatArray, limit: float = 8.0) -> NDArray[np.bool_]:
    """Find samples far off while the two before and the two after agree with each other without them.

    They agree where a ball moves on steadily, and where it rests on one side and is at the same place on the other: no
    ball leaves a place and is back there in the next frame.

    Args:
        t: (T,) s.
        xy: (T, 2) m.
        sigma: (T,) m.
        limit: Least distance of an outlier, in standard deviations of the sample.

    Returns:
        (T,) True for outliers.
    """
    is_outlier = np.zeros(len(t), bool)
    if len(t) < 5:
        return is_outlier
    left, right = xy[1:-3], xy[3:-1]
    share = ((t[2:-2] - t[1:-3]) / (t[3:-1] - t[1:-3]))[:, None]
    jump = np.linalg.norm(xy[2:-2] - (left + share * (right - left)), axis=1)
    gaps = [(late - early)[:, None] for early, late in ((t[:-4], t[1:-3]), (t[1:-3], t[3:-1]), (t[3:-1], t[4:]))]
    ways = (left - xy[:-4], right - left, xy[4:] - right)
    before, pace, after = (way / gap for way, gap in zip(ways, gaps, strict=True))
    left_by, step, goes_on = (np.linalg.norm(way, axis=1) for way in ways)
    usual = (np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1)) / 2
    # neither another speed than before and after, nor another direction
    change = np.linalg.norm(pace - (before + after) / 2, axis=1) + usual - np.linalg.norm(before + after, axis=1) / 2
    is_steady = change < 0.2 * usual + 2 * sigma[2:-2] / gaps[1][:, 0]
    is_steady &= np.linalg.norm(after - before, axis=1) < usual + 2 * sigma[2:-2] / gaps[1][:, 0]
    near = 3 * np.maximum(sigma[1:-3], sigma[3:-1])
    is_resting = np.minimum(left_by, goes_on) < near
    # a contact bends a path by at most what the ball can travel meanwhile
    is_outlier[2:-2] = (is_steady | (is_resting & (step < near))) & (jump > limit * sigma[2:-2]) & (jump > 0.5 * step)
    return is_outlier
