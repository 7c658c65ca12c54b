"""Two times: when pictures are shown, and when they were taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Clock:
    """When T pictures were shown, and when they were taken."""

    shown: FloatArray
    """(T,) s, increasing: presentation times."""
    taken: FloatArray
    """(T,) s, increasing."""
    sigma: FloatArray
    """(T,) s, how well `taken` is known; 0 where pictures were taken regularly."""

    def taken_at(self, t: FloatArray) -> FloatArray:
        """Moments of what is shown at t (...), s; beyond the pictures both run alike."""
        return _mapped(t, self.shown, self.taken)

    def shown_at(self, t: FloatArray) -> FloatArray:
        """When moments t (...) s are shown, s."""
        return _mapped(t, self.taken, self.shown)

    def rate(self, t: FloatArray) -> FloatArray:
        """d(shown)/d(taken) at moments t (...), s, when they were taken."""
        if len(self.taken) < 2:
            return np.ones_like(t)
        row = np.clip(np.searchsorted(self.taken, t, side="right") - 1, 0, len(self.taken) - 2)
        slope: FloatArray = (np.diff(self.shown) / np.diff(self.taken))[row]
        return np.where((t < self.taken[0]) | (t > self.taken[-1]), 1.0, slope)


def _mapped(t: FloatArray, source: FloatArray, goal: FloatArray) -> FloatArray:
    if len(source) < 2:
        return np.asarray(t, dtype=np.float64)
    inside = np.interp(t, source, goal)
    before, after = np.minimum(t - source[0], 0.0), np.maximum(t - source[-1], 0.0)
    return np.asarray(inside + before + after, dtype=np.float64)
