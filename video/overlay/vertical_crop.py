"""A window for upright screens that follows the action."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray, IntArray
from video.matting.ball_timeline import Sightings

SHAPE = (9, 16)
"""Width to height."""
CALM = 0.35
"""s over which the window's way is averaged: an operator's hand."""
GRID = 60.0
"""1/s, times at which the action is asked for."""
LEAST_SPEED = 0.02
"""m/s from which a ball is part of the action."""


def window_width(width: int, height: int) -> int:
    """px, even, of the window in a picture; the picture's own where that is upright already."""
    return min(width, 2 * round(height * SHAPE[0] / SHAPE[1] / 2))


def window_lefts(sightings: Sightings, times: FloatArray) -> IntArray:
    """(K,) px of the window's left border at times (K,) s: whole pixels, so that real pictures stay real."""
    width, height = sightings.scene.camera.width_px, sightings.scene.camera.height_px
    room = width - window_width(width, height)
    first, last = float(sightings.t[0]), float(sightings.t[-1])
    grid = np.linspace(first, last, max(2, int((last - first) * GRID) + 1))
    calm = _calmed(_middle(sightings, grid), (last - first) / (len(grid) - 1))
    lefts = np.interp(times, grid, calm) - (width - room) / 2
    return np.clip(np.rint(lefts), 0, room).astype(np.int64)


def _middle(sightings: Sightings, grid: FloatArray) -> FloatArray:
    """(G,) px across the picture where the action is: moving balls by their speed, held where none moves."""
    state = sightings.state(grid)
    px = sightings.scene.camera.to_pixels(state.xy, sightings.scene.table.ball_radius)[..., 0]
    speed = np.nan_to_num(np.linalg.norm(state.v, axis=-1))
    weight = np.where(np.isfinite(px) & (speed > LEAST_SPEED), np.sqrt(speed), 0.0)
    total = weight.sum(axis=1)
    acts = total > 0
    if not acts.any():
        middle = np.nanmean(sightings.centre[..., 0]) if np.isfinite(sightings.centre).any() else np.nan
        usual = sightings.scene.camera.width_px / 2
        return np.full(len(grid), middle if np.isfinite(middle) else usual)
    mean = (np.nan_to_num(px) * weight).sum(axis=1)[acts] / total[acts]
    return np.asarray(np.interp(grid, grid[acts], mean), dtype=np.float64)


def _calmed(middle: FloatArray, step: float) -> FloatArray:
    """A Gaussian average, which sees what comes as well as what was; held at both ends."""
    half = max(1, round(3 * CALM / step))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * step / CALM) ** 2)
    padded = np.pad(middle, half, mode="edge")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"), dtype=np.float64)
