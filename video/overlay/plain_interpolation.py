"""Times and crop of the frames of an interpolated clip without annotation."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np

from models.core.typing import FloatArray, IntArray
from video.io.clip import Clip
from video.matting.ball_timeline import BallTimeline

# s of jitter within which timestamps count as regular: some containers count milliseconds.
REGULAR_TOLERANCE_S = 1e-3
# Share of the frame interval within which a decoded frame replaces a synthesized one.
SNAP_SHARE = 0.02


def subdivide_frame_times(clip: Clip, factor: int) -> FloatArray:
    """Divide every gap between distinct frames evenly.

    Args:
        factor: Parts per gap.

    Returns:
        Times ((D - 1) factor + 1,), s, of D distinct frames.

    Raises:
        ValueError: The factor is below 1.
    """
    if factor < 1:
        raise ValueError(f"a factor is 1 or more; got {factor}")
    t = clip.times_of(clip.distinct_frames)
    inner = [a + (b - a) * np.arange(factor) / factor for a, b in pairwise(t)]
    return np.concatenate([*inner, t[-1:]])


def regular_frame_times(clip: Clip, rate: float) -> FloatArray:
    """Return regular times within a clip.

    Args:
        rate: Frames per second.

    Returns:
        Times (K,), s; those of decoded frames where they nearly coincide.
    """
    real = clip.times_of(clip.distinct_frames)
    times = real[0] + np.arange(int((real[-1] - real[0]) * rate + SNAP_SHARE) + 1) / rate
    after = np.clip(np.searchsorted(real, times), 1, len(real) - 1)
    nearest = np.where(times - real[after - 1] < real[after] - times, real[after - 1], real[after])
    return np.asarray(np.where(np.abs(nearest - times) * rate < SNAP_SHARE, nearest, times), dtype=np.float64)


def regular_frame_rate(clip: Clip, factor: int) -> Fraction | None:
    """Return the frame rate of a clip with subdivided gaps.

    Args:
        factor: Parts per gap.

    Returns:
        Frames per second; None where the distinct frames are not regular.
    """
    frames = clip.distinct_frames
    strides = np.diff(frames)
    if not len(strides) or (strides != strides[0]).any():
        return None
    rate = clip.fps / int(strides[0])
    t = clip.times_of(frames)
    even = t[0] + np.arange(len(frames)) / float(rate)
    return rate * factor if np.abs(t - even).max() < REGULAR_TOLERANCE_S else None


# Width to height.
ASPECT_RATIO = (9, 16)
# s, standard deviation of the smoothing of the window's motion.
SMOOTHING_S = 0.35
# 1/s, at which the action is sampled.
SAMPLE_RATE = 60.0
# m/s from which a ball is part of the action.
MIN_ACTION_SPEED = 0.02


def window_width(width: int, height: int) -> int:
    """Return the width of the crop window.

    Args:
        width: Width of the frame, px.
        height: Height of the frame, px.

    Returns:
        Even width of the window, px; that of the frame if it is upright already.
    """
    return min(width, 2 * round(height * ASPECT_RATIO[0] / ASPECT_RATIO[1] / 2))


def window_left_borders(timeline: BallTimeline, times: FloatArray) -> IntArray:
    """Return the left border of the crop window at given times.

    Args:
        timeline: Positions of the balls.
        times: Times (K,), s.

    Returns:
        Left border (K,), whole px, so that cropped frames are not resampled.
    """
    width, height = timeline.scene.camera.width_px, timeline.scene.camera.height_px
    range_px = width - window_width(width, height)
    first, last = float(timeline.t[0]), float(timeline.t[-1])
    grid = np.linspace(first, last, max(2, int((last - first) * SAMPLE_RATE) + 1))
    calm = _smooth_centre(_action_centre(timeline, grid), (last - first) / (len(grid) - 1))
    lefts = np.interp(times, grid, calm) - (width - range_px) / 2
    return np.clip(np.rint(lefts), 0, range_px).astype(np.int64)


def _action_centre(timeline: BallTimeline, grid: FloatArray) -> FloatArray:
    """Return the x coordinate (G,) px of the action: the moving balls weighted by speed, constant while none moves."""
    state = timeline.state_at(grid)
    px = timeline.scene.camera.to_pixels(state.xy, timeline.scene.table.ball_radius)[..., 0]
    speed = np.nan_to_num(np.linalg.norm(state.v, axis=-1))
    weight = np.where(np.isfinite(px) & (speed > MIN_ACTION_SPEED), np.sqrt(speed), 0.0)
    total = weight.sum(axis=1)
    acts = total > 0
    if not acts.any():
        middle = np.nanmean(timeline.centre[..., 0]) if np.isfinite(timeline.centre).any() else np.nan
        image_centre = timeline.scene.camera.width_px / 2
        return np.full(len(grid), middle if np.isfinite(middle) else image_centre)
    mean = (np.nan_to_num(px) * weight).sum(axis=1)[acts] / total[acts]
    return np.asarray(np.interp(grid, grid[acts], mean), dtype=np.float64)


def _smooth_centre(middle: FloatArray, step: float) -> FloatArray:
    """Smooth by a Gaussian, which anticipates motion; the values are constant beyond both ends."""
    half = max(1, round(3 * SMOOTHING_S / step))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * step / SMOOTHING_S) ** 2)
    padded = np.pad(middle, half, mode="edge")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"), dtype=np.float64)
