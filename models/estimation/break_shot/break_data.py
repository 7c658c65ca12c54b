"""A burst: balls that lie together, one that comes, and where all of them were seen before and shortly after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Burst:
    """N balls that lie until one more, the first, comes; they have numbers 0, 1, ... here."""

    balls: tuple[int, ...]
    """(N + 1,) their numbers in the tracks."""
    begins: float
    """s, from when on the coming ball is followed."""
    hit: float
    """s, about when it meets the others."""
    coming: FloatArray
    """(7,) its state at `begins`: place, velocity, slip, surface speed of side spin (m, m/s)."""
    coming_sigma: FloatArray
    """(7,) infinite where the samples alone tell."""
    lying: FloatArray
    """(N, 2) m, where the others lie."""
    lying_sigma: FloatArray
    """(N,) m per axis."""
    t: FloatArray
    """(K,) s, when they were seen: the first from `begins` on, the others once it has come; each until it meets a
    cushion or falls."""
    ball: IntArray
    """(K,) which of the balls."""
    xy: FloatArray
    """(K, 2) m."""
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""
    interval: float
    """s between two pictures."""
    friction: tuple[float, float]
    """Of sliding and rolling on this cloth, as far as known."""
    diameter: float
    """Distance at which balls touch, over two radii, as far as known."""
    table: Table

    @property
    def speed(self) -> float:
        """m/s of the coming ball."""
        return float(np.hypot(*self.coming[2:4]))

    def softened(self, by: float) -> Burst:
        """The same, its samples `by` times as noisy."""
        return replace(self, whiten=self.whiten / by)

    @property
    def ends(self) -> float:
        """s, when it was seen last."""
        return float(self.t.max())
