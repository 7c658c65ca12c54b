"""A camera above a table: what of the balls' paths it shows, before noise.

Lens, perspective and scale act about the middle of the table, in half table lengths; with a rolling shutter a row is
the later the farther down it lies; lost pictures are missing from the middle of every other shot on, unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]

EFFECTS: Mapping[str, tuple[str, ...]] = {
    "lens_distortion": ("k1",),
    "lens_fourth": ("k2",),
    "perspective": ("p_x", "p_y"),
    "scale": ("seen",),
    "rolling_shutter": ("readout",),
    "dropped_frames": ("frames",),
}
"""`lens_fourth` is r (1 + k2 r^4); `seen` is by how much more than its true size the table is taken for."""
RATE, FINER = 1000, 5000
"""Samples a second that a film asks for at least; the finer where rows are taken at times of their own."""


@dataclass(frozen=True)
class TableCamera:
    """Above a table of `length` and `width` (m), at `fps` pictures a second."""

    length: float
    width: float
    fps: float
    effects: Effects

    @property
    def rate(self) -> float:
        """Samples a second that a path must have: a whole number to a picture."""
        least = FINER if "rolling_shutter" in self.effects else RATE
        return float(self.fps * np.ceil(least / self.fps))

    def moments(self, pictures: int, shot: int) -> Floats:
        """(T,) s at which so many pictures of a shot are taken."""
        taken = np.arange(pictures)
        if "dropped_frames" in self.effects and shot % 2 == 0:
            taken[pictures // 3 :] += round(self.effects["dropped_frames"]["frames"])
        return np.asarray(taken / self.fps)

    def shows(self, path: Floats, t: Floats) -> Floats:
        """(T, N, 2) m at times t (T,) of a path (S, N, 2) m, sampled at `rate`: rows, scale, lens, perspective."""
        xy = path[self._samples(path, t)]
        middle, half = np.array([self.length, self.width]) / 2, self.length / 2
        if "rolling_shutter" in self.effects:
            late = self.effects["rolling_shutter"]["readout"] * (xy[..., 1] - middle[1]) / self.width
            xy = path[self._samples(path, t[:, None] + late), np.arange(path.shape[1])]
        away = (xy - middle) / half
        away = away * (1 + self._of("scale", "seen"))
        away = away * (1 + self._of("lens_distortion", "k1") * (away**2).sum(axis=-1, keepdims=True))
        away = away * (1 + self._of("lens_fourth", "k2") * (away**2).sum(axis=-1, keepdims=True) ** 2)
        farther = 1 + self._of("perspective", "p_x") * away[..., :1] + self._of("perspective", "p_y") * away[..., 1:]
        return np.asarray(middle + half * (away / farther))

    def _samples(self, path: Floats, t: Floats) -> NDArray[np.int64]:
        return np.clip(np.round(t * self.rate), 0, len(path) - 1).astype(np.int64)

    def _of(self, effect: str, parameter: str) -> float:
        return self.effects.get(effect, {}).get(parameter, 0.0)
