"""Coordinates and times as networks like them: about 1, in steps of one sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Scaling:
    """N points in D axes as C = N D numbers; one length for all of them, so that angles stay angles."""

    centre: FloatArray
    """(C,) middle of each coordinate."""
    length: float
    """half the widest range of a coordinate."""
    start: float
    """s, the first sample."""
    step: float
    """s from sample to sample, the median: the thesis' unit of time."""
    speed: FloatArray
    """(C,) typical change of each scaled coordinate within a step; 0 where a coordinate never changes."""
    shape: tuple[int, int]
    """N, D."""

    def coordinates(self, states: FloatArray) -> FloatArray:
        """(T, N, D) to (T, C)."""
        flat: FloatArray = (states.reshape(len(states), -1) - self.centre) / self.length
        return flat

    def states(self, coordinates: FloatArray) -> FloatArray:
        """(T, C) to (T, N, D)."""
        return (coordinates * self.length + self.centre).reshape(-1, *self.shape)

    def steps(self, times: FloatArray) -> FloatArray:
        """s to steps since the first sample."""
        return (times - self.start) / self.step


def scaling(times: FloatArray, states: FloatArray) -> Scaling:
    """The scales of samples (T, N, D) at (T,) s. Motions of nothing at all have length 1."""
    flat = states.reshape(len(states), -1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    length = float((high - low).max()) / 2 or 1.0
    step = float(np.median(np.diff(times)))
    change = np.diff(flat, axis=0) / np.diff(times)[:, None] * step / length
    speed = np.sqrt(np.mean(change**2, axis=0))
    return Scaling((low + high) / 2, length, float(times[0]), step, speed, (states.shape[1], states.shape[2]))
