"""Capture times of frames (when the shutter was open) and their presentation times (PTS)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class CaptureClock:
    """Presentation and capture times of T frames.

    Between frames both times are interpolated linearly; outside the clip both advance at the same rate.
    """

    presentation_time: FloatArray
    """(T,) s, presentation times, increasing."""
    capture_time: FloatArray
    """(T,) s, estimated capture times, increasing."""
    sigma: FloatArray
    """(T,) s, standard deviations of `capture_time`; 0 for frames captured at regular intervals."""

    @property
    def is_identity(self) -> bool:
        """Whether every frame was captured at its presentation time."""
        return np.array_equal(self.capture_time, self.presentation_time)

    def capture_time_at(self, t: FloatArray) -> FloatArray:
        """Convert presentation times (...) in s to capture times (...) in s."""
        return _map_times(t, self.presentation_time, self.capture_time)

    def presentation_time_at(self, t: FloatArray) -> FloatArray:
        """Convert capture times (...) in s to presentation times (...) in s."""
        return _map_times(t, self.capture_time, self.presentation_time)

    def presentation_rate_at(self, t: FloatArray) -> FloatArray:
        """Evaluate the derivative of the presentation time by the capture time, at capture times (...) in s."""
        if len(self.capture_time) < 2:
            return np.ones_like(t)
        row = np.clip(np.searchsorted(self.capture_time, t, side="right") - 1, 0, len(self.capture_time) - 2)
        slope: FloatArray = (np.diff(self.presentation_time) / np.diff(self.capture_time))[row]
        return np.where((t < self.capture_time[0]) | (t > self.capture_time[-1]), 1.0, slope)


def _map_times(t: FloatArray, source: FloatArray, target: FloatArray) -> FloatArray:
    """Map times (...) by linear interpolation from `source` (T,) to `target` (T,), with slope 1 outside."""
    if len(source) < 2:
        return np.asarray(t, dtype=np.float64)
    inside = np.interp(t, source, target)
    before, after = np.minimum(t - source[0], 0.0), np.maximum(t - source[-1], 0.0)
    return np.asarray(inside + before + after, dtype=np.float64)
