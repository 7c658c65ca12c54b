"""Data of a break shot: balls that lie together, one that comes in, and their observations before and shortly after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class BreakShot:
    """A break shot of N resting balls and the incoming one, which has index 0 here."""

    balls: tuple[int, ...]
    """(N + 1,) ball indices in the tracks."""
    start: float
    """s, from which the incoming ball is tracked."""
    hit: float
    """s, approximate time at which it meets the others."""
    incoming_state: FloatArray
    """(7,) its state at `start`: place, velocity, slip, surface speed of side spin (m, m/s)."""
    incoming_sigma: FloatArray
    """(7,) infinite where the samples alone determine it."""
    rest_places: FloatArray
    """(N, 2) m, places of the others."""
    rest_sigma: FloatArray
    """(N,) m per axis."""
    t: FloatArray
    """(K,) s, of the observations: the incoming ball from `start` on, the others after the hit; each until it meets a
    cushion or falls.
    """
    ball: IntArray
    """(K,) index among the balls here."""
    xy: FloatArray
    """(K, 2) m."""
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""
    interval: float
    """s between two frames."""
    friction: tuple[float, float]
    """Of sliding and rolling on this cloth, estimated from the clip."""
    diameter: float
    """Distance at which balls touch, over two radii, estimated from the clip."""
    table: Table
    rack: tuple[int, ...] = ()
    """Ball indices in the tracks of the resting balls that lie together."""

    @property
    def speed(self) -> float:
        """m/s of the incoming ball."""
        return float(np.hypot(*self.incoming_state[2:4]))

    def inflate_noise(self, factor: float) -> BreakShot:
        """Return the same break shot with `factor` times the noise."""
        return replace(self, whiten=self.whiten / factor)

    @property
    def end(self) -> float:
        """s, of the last observation."""
        return float(self.t.max())
