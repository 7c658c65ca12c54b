"""Multiple shooting with a state at every sample: chains of states linked by a flow.

A chaotic motion forgets its start within seconds, so each simulation runs only from one sample to the next. Links are
loose at first, so that bad guesses of velocities and of shared parameters bend the chain without breaking the search,
and are tightened until the chain is one motion (weak-constraint assimilation, Tremolet 2006, doi:10.1256/qj.05.224;
multiple shooting, Bock 1983, doi:10.1007/978-1-4684-3324-1_15). The normal equations are a band with a border, so that
the cost grows linearly with the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from models.core.typing import FloatArray
from models.numerics.least_squares import SearchOptions, minimize_cost

# Largest step of a shared coordinate in one iteration, in units of its scale.
MAX_STEP = 0.5
# Ridge, relative to the diagonal.
_RIDGE = 1e-12
# Of the states and shared coordinates of a chain.
_SEARCH = SearchOptions(
    iterations=40, attempts=8, min_relative_gain=1e-4, damping=1e-4, lowering=1 / 8, raising=10.0, least_raised=1e-4
)


@dataclass(frozen=True, slots=True)
class ChainPrediction:
    """Prediction of a chain of K states with S variables, L = K - 1 links and P shared coordinates."""

    ends: FloatArray
    """(L, S) prediction of the next sample from each state."""
    state_jacobian: FloatArray
    """(L, S, S) derivative of `ends` by the states."""
    shared_jacobian: FloatArray
    """(L, S, P) derivative of `ends` by the shared coordinates."""
    constraints: FloatArray
    """(K, R) residuals of constraints on every state, in standard deviations: rods have their length."""
    constraint_state_jacobian: FloatArray
    """(K, R, S)"""
    constraint_shared_jacobian: FloatArray
    """(K, R, P)"""


class ChainModel(Protocol):
    """A model that predicts chains of states."""

    def predict(self, states: FloatArray, shared: FloatArray) -> ChainPrediction:
        """Predict the next sample from each of the states (K, S), with shared coordinates (P,)."""

    def clip_shared(self, shared: FloatArray) -> FloatArray:
        """Return the nearest possible shared coordinates (P,)."""


@dataclass(frozen=True, slots=True)
class ChainObservations:
    """Observations of a chain: values and 1/sigma, 0 where nothing was observed."""

    states: FloatArray
    """(K, S)"""
    weight: FloatArray
    """(K, S)"""
    shared: FloatArray
    """(P,) direct observations or prior means of the shared coordinates."""
    shared_weight: FloatArray
    """(P,) 1/sigma."""
    scale: FloatArray
    """(P,) typical step of a shared coordinate."""
    state_scale: FloatArray
    """(S,) typical step of a state variable."""


@dataclass(frozen=True, slots=True)
class ChainEstimate:
    """One iterate of the search."""

    states: FloatArray
    """(K, S)"""
    shared: FloatArray
    """(P,)"""
    link_sigma: FloatArray
    """(S,) standard deviation of a link."""
    prediction: ChainPrediction
    cost: float
    """chi2 of observations, links and constraints."""
    converged: bool = False


@dataclass(frozen=True, slots=True)
class BandedNormalEquations:
    """Normal equations: blocks on and beside the diagonal, border and corner."""

    diagonal: FloatArray
    """(K, S, S)"""
    off_diagonal: FloatArray
    """(L, S, S) of states k and k + 1."""
    border: FloatArray
    """(K, S, P)"""
    corner: FloatArray
    """(P, P)"""
    gradient: FloatArray
    """(K, S)"""
    shared_gradient: FloatArray
    """(P,)"""


def start_chain(
    model: ChainModel, observed: ChainObservations, states: FloatArray, shared: FloatArray, link_sigma: FloatArray
) -> ChainEstimate:
    """Evaluate the first iterate of a search.

    Args:
        model: Model that predicts the chain.
        observed: Observations of the chain.
        states: (K, S) initial guess.
        shared: (P,) initial guess.
        link_sigma: (S,) standard deviation of a link.

    Returns:
        The iterate.
    """
    prediction = model.predict(states, shared)
    return ChainEstimate(
        states, shared, link_sigma, prediction, _chain_cost(observed, states, shared, link_sigma, prediction)
    )


def minimize_chain(
    model: ChainModel, observed: ChainObservations, chain: ChainEstimate, iterations: int
) -> ChainEstimate:
    """Minimize the cost of a chain by Levenberg-Marquardt steps.

    Args:
        model: Model that predicts the chain.
        observed: Observations of the chain.
        chain: Iterate to start from.
        iterations: Largest number of steps.

    Returns:
        The last iterate; `converged` where no further decrease was possible.
    """

    def move(now: ChainEstimate, step: tuple[FloatArray, FloatArray]) -> tuple[ChainEstimate, float]:
        states, shared = now.states + step[0], model.clip_shared(now.shared + step[1])
        trial = start_chain(model, observed, states, shared, now.link_sigma)
        return trial, trial.cost

    best = minimize_cost(
        chain,
        chain.cost,
        lambda now: build_normal_equations(observed, now),
        lambda band, damping: _solve_step(observed, band, damping),
        move,
        replace(_SEARCH, iterations=iterations),
    )
    return replace(best.point, converged=best.outcome != "interrupted")


def _chain_cost(
    observed: ChainObservations,
    states: FloatArray,
    shared: FloatArray,
    link_sigma: FloatArray,
    prediction: ChainPrediction,
) -> float:
    """Compute chi2 of observations, links and constraints; infinite where it is not finite."""
    parts = (
        (states - observed.states) * observed.weight,
        (shared - observed.shared) * observed.shared_weight,
        (states[1:] - prediction.ends) / link_sigma,
        prediction.constraints,
    )
    cost = float(sum((part**2).sum() for part in parts))
    return cost if np.isfinite(cost) else float("inf")


def build_normal_equations(observed: ChainObservations, chain: ChainEstimate) -> BandedNormalEquations:
    """Build the normal equations at an iterate.

    Args:
        observed: Observations of the chain.
        chain: Iterate.

    Returns:
        Blocks of the banded, bordered matrix and the gradient.
    """
    p, loose = chain.prediction, 1 / chain.link_sigma**2
    miss = chain.states[1:] - p.ends
    diagonal = np.einsum("kri,krj->kij", p.constraint_state_jacobian, p.constraint_state_jacobian)
    diagonal[:-1] += np.einsum("ksi,s,ksj->kij", p.state_jacobian, loose, p.state_jacobian)
    diagonal[1:] += np.diag(loose)
    index = np.arange(diagonal.shape[1])
    diagonal[:, index, index] += observed.weight**2
    border = np.einsum("kri,krp->kip", p.constraint_state_jacobian, p.constraint_shared_jacobian)
    border[:-1] += np.einsum("ksi,s,ksp->kip", p.state_jacobian, loose, p.shared_jacobian)
    border[1:] -= loose[:, None] * p.shared_jacobian
    corner = np.einsum("ksp,s,ksq->pq", p.shared_jacobian, loose, p.shared_jacobian)
    corner += np.einsum("krp,krq->pq", p.constraint_shared_jacobian, p.constraint_shared_jacobian) + np.diag(
        observed.shared_weight**2
    )
    gradient = observed.weight**2 * (chain.states - observed.states) + np.einsum(
        "kri,kr->ki", p.constraint_state_jacobian, p.constraints
    )
    gradient[:-1] -= np.einsum("ksi,s,ks->ki", p.state_jacobian, loose, miss)
    gradient[1:] += loose * miss
    shared_gradient = observed.shared_weight**2 * (chain.shared - observed.shared)
    shared_gradient = shared_gradient - np.einsum("ksp,s,ks->p", p.shared_jacobian, loose, miss)
    shared_gradient += np.einsum("krp,kr->p", p.constraint_shared_jacobian, p.constraints)
    beside = -np.swapaxes(p.state_jacobian, 1, 2) * loose
    return BandedNormalEquations(diagonal, beside, border, corner, gradient, shared_gradient)


def information_of_shared(band: BandedNormalEquations) -> FloatArray:
    """Compute the information about the shared coordinates, the states being unknown.

    Args:
        band: Normal equations of a chain.

    Returns:
        (P, P) Schur complement.
    """
    inside = _solve_banded(band, np.zeros(band.gradient.shape[1]), band.border)
    return np.asarray(band.corner - np.einsum("ksp,ksq->pq", band.border, inside), np.float64)


def state_covariance(band: BandedNormalEquations, shared: FloatArray) -> FloatArray:
    """Compute the covariance (S, S) of the first state, given that (P, P) of the shared coordinates."""
    count, size, _ = band.border.shape
    units = np.zeros((count, size, size))
    units[0] = np.eye(size)
    none = np.zeros(size)
    inner, response = _solve_banded(band, none, units)[0], _solve_banded(band, none, band.border)[0]
    return np.asarray(inner + response @ shared @ response.T, np.float64)


def _solve_step(
    observed: ChainObservations, band: BandedNormalEquations, damping: float
) -> tuple[FloatArray, FloatArray] | None:
    """Compute the steps of states (K, S) and shared coordinates (P,), bounded in the scales of the latter.

    None where the equations have no solution.
    """
    right = np.concatenate([band.border, band.gradient[:, :, None]], axis=2)
    extra = damping * float((observed.weight**2).max()) * (observed.state_scale.min() / observed.state_scale) ** 2
    try:
        inside = _solve_banded(band, extra, right)
        whole = band.corner - np.einsum("ksp,ksq->pq", band.border, inside[:, :, :-1])
        whole += np.diag(
            damping * np.diag(band.corner) + _RIDGE * np.diag(band.corner) + 1e-3 * damping / observed.scale**2
        )
        push = -band.shared_gradient + np.einsum("ksp,ks->p", band.border, inside[:, :, -1])
        size = 1 / np.sqrt(np.diag(whole).clip(1e-300))
        shared = size * np.linalg.solve(whole * size * size[:, None], push * size)
    except LinAlgError:
        return None
    shared = shared / max(1.0, float(np.max(np.abs(shared) / observed.scale, initial=0.0)) / MAX_STEP)
    return -(inside[:, :, -1] + inside[:, :, :-1] @ shared), shared


def _solve_banded(band: BandedNormalEquations, extra: FloatArray, right: FloatArray) -> FloatArray:
    """Solve the equations of the states for `right` (K, S, Q), with `extra` (S,) added to the diagonal."""
    count, size, columns = right.shape
    stored = np.zeros((2 * size, count * size))
    i, j = np.indices((size, size))
    low = i >= j
    base = size * np.arange(count)[:, None, None]
    blocks = band.diagonal + np.diag(extra + _RIDGE * band.diagonal.max(axis=(0, 1)))
    stored[(i - j)[low], (base + j)[:, low]] = blocks[:, low]
    stored[i - j + size, base[:-1] + j] = np.swapaxes(band.off_diagonal, 1, 2)
    flat = solveh_banded(stored, right.reshape(count * size, columns), lower=True, check_finite=False)
    return np.asarray(flat, np.float64).reshape(right.shape)
