"""Film paths of balls on a table, before noise.

Lens, perspective and scale act about the middle of the table, in half table lengths; with a rolling shutter, a row is
captured later the further down it lies; dropped frames are missing from the middle of every other shot, unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]

# `lens_fourth` is r (1 + k2 r^4); `seen` is the relative error of the assumed size of the table.
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "lens_distortion": ("k1",),
    "lens_fourth": ("k2",),
    "perspective": ("p_x", "p_y"),
    "scale": ("seen",),
    "rolling_shutter": ("readout",),
    "dropped_frames": ("frames",),
}
# Least number of samples per second; the finer rate is for a rolling shutter.
RATE, FINER = 1000, 5000


@dataclass(frozen=True)
class TableCamera:
    """A camera above a table of `length` and `width` (m), at `fps` frames per second."""

    length: float
    width: float
    fps: float
    effects: Effects

    @property
    def rate(self) -> float:
        """Samples per second that a path must have: a whole number per frame."""
        least = FINER if "rolling_shutter" in self.effects else RATE
        return float(self.fps * np.ceil(least / self.fps))

    def capture_times(self, frames: int, shot: int) -> Floats:
        """Return the capture times (T,) s of the frames of a shot."""
        frame = np.arange(frames)
        if "dropped_frames" in self.effects and shot % 2 == 0:
            frame[frames // 3 :] += round(self.effects["dropped_frames"]["frames"])
        return np.asarray(frame / self.fps)

    def film_path(self, path: Floats, t: Floats) -> Floats:
        """Return positions (T, N, 2) m at t (T,) of a path (S, N, 2) m, sampled at `rate`, as the camera shows them."""
        xy = path[self._sample_rows(path, t)]
        middle, half = np.array([self.length, self.width]) / 2, self.length / 2
        if "rolling_shutter" in self.effects:
            late = self.effects["rolling_shutter"]["readout"] * (xy[..., 1] - middle[1]) / self.width
            xy = path[self._sample_rows(path, t[:, None] + late), np.arange(path.shape[1])]
        away = (xy - middle) / half
        away = away * (1 + self._effect_value("scale", "seen"))
        away = away * (1 + self._effect_value("lens_distortion", "k1") * (away**2).sum(axis=-1, keepdims=True))
        away = away * (1 + self._effect_value("lens_fourth", "k2") * (away**2).sum(axis=-1, keepdims=True) ** 2)
        farther = (
            1
            + self._effect_value("perspective", "p_x") * away[..., :1]
            + self._effect_value("perspective", "p_y") * away[..., 1:]
        )
        return np.asarray(middle + half * (away / farther))

    def _sample_rows(self, path: Floats, t: Floats) -> NDArray[np.int64]:
        return np.clip(np.round(t * self.rate), 0, len(path) - 1).astype(np.int64)

    def _effect_value(self, effect: str, parameter: str) -> float:
        return self.effects.get(effect, {}).get(parameter, 0.0)
