"""Normalisation of coordinates to about 1 and of times to sample intervals, for networks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Scaling:
    """Scales of the motion of N points in D axes, flattened to C = N D coordinates.

    All coordinates share one length, so that angles are preserved.
    """

    centre: FloatArray
    """(C,) middle of the range of each coordinate."""
    length: float
    """Half the widest range of a coordinate, in the unit of the coordinates."""
    start: float
    """s, time of the first sample."""
    step: float
    """s, median sample interval: the unit of time of Chen 2022."""
    speed: FloatArray
    """(C,) root mean square change of each scaled coordinate per step; 0 for a coordinate that never changes."""
    shape: tuple[int, int]
    """N and D."""

    def scale_states(self, states: FloatArray) -> FloatArray:
        """Convert states (T, N, D) to scaled coordinates (T, C)."""
        flat: FloatArray = (states.reshape(len(states), -1) - self.centre) / self.length
        return flat

    def restore_states(self, coordinates: FloatArray) -> FloatArray:
        """Convert scaled coordinates (T, C) back to states (T, N, D)."""
        return (coordinates * self.length + self.centre).reshape(-1, *self.shape)

    def count_steps(self, times: FloatArray) -> FloatArray:
        """Convert times in s to steps since the first sample."""
        return (times - self.start) / self.step


def estimate_scaling(times: FloatArray, states: FloatArray) -> Scaling:
    """Estimate the scales of a motion.

    Args:
        times: Times (T,), s.
        states: Coordinates (T, N, D).

    Returns:
        The scales; the length of a motion without any change is 1.
    """
    flat = states.reshape(len(states), -1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    length = float((high - low).max()) / 2 or 1.0
    step = float(np.median(np.diff(times)))
    change = np.diff(flat, axis=0) / np.diff(times)[:, None] * step / length
    speed = np.sqrt(np.mean(change**2, axis=0))
    return Scaling((low + high) / 2, length, float(times[0]), step, speed, (states.shape[1], states.shape[2]))
