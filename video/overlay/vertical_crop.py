"""Crop window for upright screens that follows the action."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray, IntArray
from video.matting.ball_timeline import BallTimeline

ASPECT_RATIO = (9, 16)
"""Width to height."""
SMOOTHING_S = 0.35
"""s, standard deviation of the smoothing of the window's motion."""
SAMPLE_RATE = 60.0
"""1/s, at which the action is sampled."""
MIN_ACTION_SPEED = 0.02
"""m/s from which a ball is part of the action."""


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
