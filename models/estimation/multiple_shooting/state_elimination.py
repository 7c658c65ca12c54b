"""Normal equations of many shots that share a few numbers: the states of each shot are eliminated on their own.

The matrix has the shape of an arrow: blocks of states on the diagonal, the shared numbers at the border. Its Schur
complement is as small as what is shared, so that the cost grows linearly with the number of shots (Triggs et al.
2000, "Bundle adjustment", section 6.1, doi:10.1007/3-540-44480-7_21).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from models.core.typing import FloatArray

LEAST_KNOWN = 1e-6
"""1/variance of a number that nothing tells, in its own unit."""
RIDGE = 1e-10
"""relative to what is known of a number: far above the rounding errors of a large fit."""


@dataclass(slots=True)
class ShotBlock:
    """Sums over the rows of one shot; M numbers of state, P shared ones."""

    states: FloatArray
    """(M, M)"""
    coupling: FloatArray
    """(M, P)"""
    shared: FloatArray
    """(P, P)"""
    gradient: FloatArray
    """(M,)"""
    shared_gradient: FloatArray
    """(P,)"""

    @classmethod
    def empty(cls, states: int, shared: int) -> ShotBlock:
        return cls(
            np.zeros((states, states)), np.zeros((states, shared)), np.zeros((shared, shared)),
            np.zeros(states), np.zeros(shared),
        )  # fmt: skip

    def add(self, where: slice, by_states: FloatArray, by_shared: FloatArray, residual: FloatArray) -> None:
        """Rows with slopes (R, m) by the states at `where`, (R, P) by the shared numbers, and residuals (R,)."""
        self.states[where, where] += by_states.T @ by_states
        self.coupling[where] += by_states.T @ by_shared
        self.shared += by_shared.T @ by_shared
        self.gradient[where] += by_states.T @ residual
        self.shared_gradient += by_shared.T @ residual

    def know(self, where: slice, residual: FloatArray, sigma: FloatArray) -> None:
        """The states at `where` are known to be `residual` (m,) off, to `sigma` (m,); infinite: nothing is known."""
        told = 1 / sigma
        np.einsum("ii->i", self.states)[where] += told * told
        self.gradient[where] += told * (residual / sigma)

    def reduced(self) -> FloatArray:
        """(P, P) what the shot tells of the shared numbers, its states unknown."""
        return self.shared - self.coupling.T @ solved(self.states, self.coupling, 0.0)


def log_determinant(normal: FloatArray) -> float:
    """Of normal equations (M, M), what nothing tells left out."""
    known = np.diag(normal) > LEAST_KNOWN
    return float(np.linalg.slogdet(normal[np.ix_(known, known)])[1])


def solved(normal: FloatArray, right: FloatArray, damping: float) -> FloatArray:
    """Solution (M, ...) of damped normal equations (M, M), also where nothing is known about a number.

    Scaled to a unit diagonal, so that one small ridge makes every finite matrix invertible.
    """
    if not np.isfinite(normal).all():
        raise np.linalg.LinAlgError("the normal equations of a fit hold numbers that are not finite")
    if len(normal) == 0:
        return np.asarray(right, dtype=np.float64)
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), LEAST_KNOWN))
    scaled = normal * scale * scale[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + RIDGE
    column = scale.reshape(-1, *[1] * (right.ndim - 1))
    factor, failed = dpotrf(scaled, clean=False)
    if not failed:
        return np.asarray(dpotrs(factor, right * column)[0].reshape(right.shape) * column, dtype=np.float64)
    # what elimination left of numbers that states nearly replace: rounding, below zero
    sizes, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    turned = axes.T @ (right * column).reshape(len(normal), -1) / np.maximum(sizes, damping + RIDGE)[:, None]
    return np.asarray((axes @ turned).reshape(right.shape) * column, dtype=np.float64)


def eliminate(
    blocks: list[ShotBlock],
    prior: FloatArray,
    prior_gradient: FloatArray,
    damping: float,
    held: NDArray[np.bool_],
    reach: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[FloatArray, list[FloatArray]]:
    """Levenberg-Marquardt step of the shared numbers (P,), those `held` (P,) kept, and of each shot's states (M,).

    `reach`: least and largest step of each shared number (P,); the states follow the step that is left.
    """
    whole, right = prior.copy(), -prior_gradient
    inner = []
    for block in blocks:
        states = block.states.copy()
        states[np.diag_indices_from(states)] *= 1 + damping
        inside = solved(states, np.column_stack([block.coupling, block.gradient]), 0.0)
        inner.append(inside)
        whole = whole + block.shared - block.coupling.T @ inside[:, :-1]
        right = right - block.shared_gradient + block.coupling.T @ inside[:, -1]
    whole[held] = whole[:, held] = 0.0
    step = np.where(held, 0.0, solved(whole + np.diag(held.astype(float)), right, damping))
    if reach is not None:
        step = np.clip(step, *reach)
    return step, [-(inside[:, -1] + inside[:, :-1] @ step) for inside in inner]
