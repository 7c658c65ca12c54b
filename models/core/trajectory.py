"""Where every ball is at any time: closed-form pieces between events."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.capture_clock import Clock
from models.core.typing import FloatArray

PHASES = ("slide", "roll", "rest", "measured")
"""`measured`: no accepted physics there; a curve through the measured positions."""


@dataclass(frozen=True, slots=True)
class State:
    """N balls at times (...)."""

    xy: FloatArray
    """(..., N, 2) m; NaN before a ball appears or after it is potted."""
    v: FloatArray
    """(..., N, 2) m/s."""
    w: FloatArray
    """(..., N, 3) rad/s; NaN where unknown."""
    sigma: FloatArray
    """(..., N) m."""
    sigma_v: FloatArray
    """(..., N) m/s."""
    measured: NDArray[np.bool_]
    """(..., N) True where no accepted physics holds."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """M pieces of the motion of N balls.

    Within a piece, with tau = t - start: x(tau) = sum_k position[k] tau^k, w(tau) = spin[0] + spin[1] tau. Where a
    `clock` says that pictures were not taken when they are shown, t and the pieces are times of showing, tau is the
    time that went by before the camera, and velocities are those that the balls had.
    The pieces of a ball do not overlap; a ball is undefined outside them.
    """

    ids: tuple[str, ...]
    """(N,)"""
    ball: NDArray[np.int64]
    """(M,) index into `ids`; pieces sorted by ball, then by start."""
    start: FloatArray
    """(M,) s."""
    end: FloatArray
    """(M,) s, > start."""
    position: FloatArray
    """(M, 4, 2) m/s^k."""
    spin: FloatArray
    """(M, 2, 3) rad/s, rad/s^2; NaN where unknown."""
    phase: tuple[str, ...]
    """(M,) one of `PHASES`."""
    covariance: FloatArray
    """(M, 4, 4) of (x, y, vx, vy) at `start`, SI units."""
    clock: Clock | None = None

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

    def at(self, t: float | FloatArray) -> State:
        """State of every ball at times t (...), s."""
        times = np.asarray(t, dtype=np.float64)
        flat = times.reshape(-1)
        shape = (*times.shape, len(self.ids))
        columns = [self._of_ball(ball, flat) for ball in range(len(self.ids))]
        if not columns:
            empty = np.empty((*shape, 2))
            return State(empty, empty, np.empty((*shape, 3)), np.empty(shape), np.empty(shape), np.empty(shape, bool))
        xy, v, w, sigma, sigma_v, measured = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
        return State(
            xy.reshape(*shape, 2), v.reshape(*shape, 2), w.reshape(*shape, 3),
            sigma.reshape(shape), sigma_v.reshape(shape), measured.reshape(shape).astype(bool),
        )  # fmt: skip

    def _of_ball(self, ball: int, t: FloatArray) -> tuple[FloatArray, ...]:
        """xy (T, 2), v (T, 2), w (T, 3), sigma (T,), sigma_v (T,), measured (T,) of one ball."""
        rows = np.flatnonzero(self.ball == ball)
        nothing = (len(t),)
        if not len(rows):
            return (
                *(np.full((*nothing, k), np.nan) for k in (2, 2, 3)),
                *(np.full(nothing, np.nan) for _ in range(2)),
                np.zeros(nothing),
            )
        place = np.clip(np.searchsorted(self.start[rows], t, side="right") - 1, 0, None)
        row = rows[place]
        outside = (t < self.start[row] - 1e-12) | (t > self.end[row] + 1e-12)
        tau = self._elapsed(self.start[row], t)[:, None]
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
        measured = np.array([self.phase[m] == "measured" for m in rows])[place] & ~outside
        return xy, v, w, sigma, sigma_v, measured.astype(np.float64)

    def _elapsed(self, start: FloatArray, t: FloatArray) -> FloatArray:
        """s that went by from what is shown at `start` to what is shown at t."""
        return t - start if self.clock is None else self.clock.taken_at(t) - self.clock.taken_at(start)
