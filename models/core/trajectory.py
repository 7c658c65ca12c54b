"""Motion of all balls as polynomial pieces, and the clock of its times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


# Phases of motion. `measured`: no accepted fit; the piece is a curve through the measured positions.
PHASES = ("slide", "roll", "rest", "measured")
# s before the end of a piece, where it is sampled: no ball moves visibly in that time.
MEETING_TIME = 1e-6


@dataclass(frozen=True, slots=True)
class State:
    """State of N balls at times (...), in table coordinates."""

    xy: FloatArray
    """(..., N, 2) m, position; NaN before a ball appears and after it is pocketed."""
    v: FloatArray
    """(..., N, 2) m/s, velocity."""
    w: FloatArray
    """(..., N, 3) rad/s, angular velocity; NaN where unknown."""
    sigma: FloatArray
    """(..., N) m, standard deviation of the position, root mean square of both axes."""
    sigma_v: FloatArray
    """(..., N) m/s, standard deviation of the velocity, root mean square of both axes."""
    measured: NDArray[np.bool_]
    """(..., N) whether the position comes from a curve through measurements, without an accepted fit."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Motion of N balls as M polynomial pieces.

    Within a piece, with tau = t - start: x(tau) = sum_k position[k] tau^k, w(tau) = spin[0] + spin[1] tau. With a
    `clock`, t and the limits of the pieces are presentation times, while tau is the difference of capture times; so
    velocities are physical. The pieces of a ball do not overlap; its state is undefined outside them.
    """

    ids: tuple[str, ...]
    """(N,) ids of the balls."""
    ball: NDArray[np.int64]
    """(M,) index into `ids`. Pieces are sorted by ball, then by start."""
    start: FloatArray
    """(M,) s, begin of the piece."""
    end: FloatArray
    """(M,) s, end of the piece, > `start`."""
    position: FloatArray
    """(M, 4, 2) m/s^k, coefficients of the position."""
    spin: FloatArray
    """(M, 2, 3) rad/s and rad/s^2, coefficients of the angular velocity; NaN where unknown."""
    phase: tuple[str, ...]
    """(M,) one of `PHASES`."""
    covariance: FloatArray
    """(M, 4, 4) covariance of (x, y, vx, vy) at `start`, SI units."""
    clock: CaptureClock | None = None
    """Capture times of the frames; None if they equal the presentation times."""

    def __post_init__(self) -> None:
        pieces = len(self.ball)
        for name, shape in (
            ("start", (pieces,)), ("end", (pieces,)), ("position", (pieces, 4, 2)),
            ("spin", (pieces, 2, 3)), ("covariance", (pieces, 4, 4)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"Trajectory.{name} must be {shape}; got {getattr(self, name).shape}")
        if len(self.phase) != pieces or set(self.phase) - set(PHASES):
            raise ValueError(f"Trajectory.phase must name {pieces} of {PHASES}")
        if np.any(self.end <= self.start):
            raise ValueError("Trajectory pieces must end after they start")
        if pieces > 1 and np.any((np.diff(self.ball) < 0) | ((np.diff(self.ball) == 0) & (np.diff(self.start) < 0))):
            raise ValueError("Trajectory pieces must be sorted by ball, then by start")

    def sample_times(self, hz: float) -> FloatArray:
        """Sample times (K,) s of the motion evenly, and on both sides of where two pieces meet: paths bend there.

        Args:
            hz: Samples per second.
        """
        if not len(self.start):
            return np.empty(0)
        first, last = float(self.start.min()), float(self.end.max())
        even = np.linspace(first, last, max(2, round((last - first) * hz) + 1))
        return np.unique(np.concatenate([even, self.start, self.end - MEETING_TIME]))

    def at(self, t: float | FloatArray) -> State:
        """Evaluate the state of every ball.

        Args:
            t: Times (...), s.

        Returns:
            The states, with arrays (..., N, ...).
        """
        times = np.asarray(t, dtype=np.float64)
        flat = times.reshape(-1)
        shape = (*times.shape, len(self.ids))
        columns = [self._evaluate_ball(ball, flat) for ball in range(len(self.ids))]
        if not columns:
            empty = np.empty((*shape, 2))
            return State(empty, empty, np.empty((*shape, 3)), np.empty(shape), np.empty(shape), np.empty(shape, bool))
        xy, v, w, sigma, sigma_v, measured = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
        return State(
            xy.reshape(*shape, 2), v.reshape(*shape, 2), w.reshape(*shape, 3),
            sigma.reshape(shape), sigma_v.reshape(shape), measured.reshape(shape).astype(bool),
        )  # fmt: skip

    def _evaluate_ball(self, ball: int, t: FloatArray) -> tuple[FloatArray, ...]:
        """Evaluate one ball: xy (T, 2), v (T, 2), w (T, 3), sigma (T,), sigma_v (T,), measured (T,)."""
        rows = np.flatnonzero(self.ball == ball)
        shape = (len(t),)
        if not len(rows):
            return (
                *(np.full((*shape, k), np.nan) for k in (2, 2, 3)),
                *(np.full(shape, np.nan) for _ in range(2)),
                np.zeros(shape),
            )
        piece = np.clip(np.searchsorted(self.start[rows], t, side="right") - 1, 0, None)
        row = rows[piece]
        outside = (t < self.start[row] - 1e-12) | (t > self.end[row] + 1e-12)
        tau = self._capture_interval(self.start[row], t)[:, None]
        c = self.position[row]
        xy = c[:, 0] + tau * (c[:, 1] + tau * (c[:, 2] + tau * c[:, 3]))
        v = c[:, 1] + tau * (2 * c[:, 2] + tau * 3 * c[:, 3])
        w = self.spin[row, 0] + tau * self.spin[row, 1]
        p = self.covariance[row]
        xx, xv, vv = p[:, [0, 1], [0, 1]], p[:, [0, 1], [2, 3]], p[:, [2, 3], [2, 3]]
        sigma = np.sqrt(np.maximum(xx + 2 * tau * xv + tau**2 * vv, 0).mean(axis=1))
        sigma_v = np.sqrt(vv.mean(axis=1))
        for values in (xy, v, w, sigma, sigma_v):
            values[outside] = np.nan
        measured = np.array([self.phase[m] == "measured" for m in rows])[piece] & ~outside
        return xy, v, w, sigma, sigma_v, measured.astype(np.float64)

    def _capture_interval(self, start: FloatArray, t: FloatArray) -> FloatArray:
        """Return the capture time, s, that passed between the presentation times `start` and `t`."""
        return t - start if self.clock is None else self.clock.capture_time_at(t) - self.clock.capture_time_at(start)
