"""Elimination of the states of each chain from normal equations with a few shared parameters.

The matrix has the shape of an arrow: blocks of states on the diagonal, the shared parameters at the border. Its Schur
complement has the size of the shared parameters, so that the cost grows linearly with the number of chains (Triggs et
al. 2000, "Bundle adjustment", section 6.1, doi:10.1007/3-540-44480-7_21).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.least_squares import MIN_INFORMATION, solve_damped


@dataclass(slots=True)
class ChainBlock:
    """Normal equations of one chain; M state variables, P shared parameters."""

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
    def empty(cls, states: int, shared: int) -> ChainBlock:
        """Create a block of zeros."""
        return cls(
            np.zeros((states, states)), np.zeros((states, shared)), np.zeros((shared, shared)),
            np.zeros(states), np.zeros(shared),
        )  # fmt: skip

    def add_rows(self, where: slice, by_states: FloatArray, by_shared: FloatArray, residual: FloatArray) -> None:
        """Add rows of residuals.

        Args:
            where: The m state variables that the rows depend on.
            by_states: (R, m) Jacobian by these states.
            by_shared: (R, P) Jacobian by the shared parameters.
            residual: (R,) residuals in standard deviations.
        """
        self.states[where, where] += by_states.T @ by_states
        self.gradient[where] += by_states.T @ residual
        if len(self.shared):
            self.coupling[where] += by_states.T @ by_shared
            self.shared += by_shared.T @ by_shared
            self.shared_gradient += by_shared.T @ residual

    def add_prior(self, where: slice, residual: FloatArray, sigma: FloatArray) -> None:
        """Add a prior of the states at `where`: offset from its mean (m,), and sigma (m,), infinite where unknown."""
        inverse_sigma = 1 / sigma
        np.einsum("ii->i", self.states)[where] += inverse_sigma * inverse_sigma
        self.gradient[where] += inverse_sigma * (residual / sigma)

    def schur_complement(self) -> FloatArray:
        """Compute the information (P, P) of the chain about the shared parameters, its states being unknown."""
        return self.shared - self.coupling.T @ solve_damped(self.states, self.coupling, 0.0)


def log_determinant(normal: FloatArray) -> float:
    """Compute the log determinant of normal equations (M, M), without variables that no row constrains."""
    is_known = np.diag(normal) > MIN_INFORMATION
    return float(np.linalg.slogdet(normal[np.ix_(is_known, is_known)])[1])


def eliminate_states(
    blocks: list[ChainBlock],
    prior: FloatArray,
    prior_gradient: FloatArray,
    damping: float,
    is_fixed: NDArray[np.bool_],
    step_bounds: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[FloatArray, list[FloatArray]]:
    """Compute a Levenberg-Marquardt step of the shared parameters and of the states of each chain.

    Args:
        blocks: Normal equations of each chain.
        prior: (P, P) information of the priors of the shared parameters.
        prior_gradient: (P,) gradient of the priors.
        damping: Levenberg-Marquardt damping.
        is_fixed: (P,) shared parameters that must not move.
        step_bounds: Lower and upper bound (P,) of the step of each shared parameter; the states follow the bounded
            step.

    Returns:
        Step (P,) of the shared parameters and step (M,) of the states of each chain.
    """
    whole, right = prior.copy(), -prior_gradient
    inner = []
    for block in blocks:
        states = block.states.copy()
        states[np.diag_indices_from(states)] *= 1 + damping
        inside = solve_damped(states, np.column_stack([block.coupling, block.gradient]), 0.0)
        inner.append(inside)
        whole = whole + block.shared - block.coupling.T @ inside[:, :-1]
        right = right - block.shared_gradient + block.coupling.T @ inside[:, -1]
    whole[is_fixed] = whole[:, is_fixed] = 0.0
    step = np.where(is_fixed, 0.0, solve_damped(whole + np.diag(is_fixed.astype(float)), right, damping))
    if step_bounds is not None:
        step = np.clip(step, *step_bounds)
    return step, [-(inside[:, -1] + inside[:, :-1] @ step) for inside in inner]
