"""Multiple shooting with a state at every sample: chains of states that a flow ties to each other.

A chaotic motion forgets its start within seconds, so no simulation is asked to run longer than from one sample to the
next. Ties are loose at first, so that bad guesses of speeds and of shared numbers bend the chain instead of breaking
the search, and are tightened until the chain is one motion (weak-constraint assimilation, Tremolet 2006,
doi:10.1256/qj.05.224; multiple shooting, Bock 1983, doi:10.1007/978-1-4684-3324-1_15). The normal equations are a band
with a border, so that the cost grows linearly with the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from models.core.typing import FloatArray

LONGEST_STEP = 0.5
"""of a shared coordinate in one iteration, in units of its scale."""
_RIDGE = 1e-12
"""relative, of what is known of a number."""
_DAMPINGS = 8
"""how often a step is shortened before the search gives up."""
_QUIET = 1e-4
"""relative gain of an iteration below which a search has ended."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a flow says of a chain of K states with S numbers, tied by L = K - 1 links; P shared coordinates."""

    ends: FloatArray
    """(L, S) where the motion from each state is at the next sample."""
    by_state: FloatArray
    """(L, S, S)"""
    by_shared: FloatArray
    """(L, S, P)"""
    bonds: FloatArray
    """(K, R) what must vanish in every state, in standard deviations: rods have their length."""
    bonds_by_state: FloatArray
    """(K, R, S)"""
    bonds_by_shared: FloatArray
    """(K, R, P)"""


class ChainModel(Protocol):
    """Who predicts."""

    def predict(self, states: FloatArray, shared: FloatArray) -> Prediction:
        """From states (K, S) and shared coordinates (P,)."""
        ...

    def allowed(self, shared: FloatArray) -> FloatArray:
        """The nearest shared coordinates (P,) that are possible."""
        ...


@dataclass(frozen=True, slots=True)
class Seen:
    """Observations of a chain: values and 1/sigma, 0 where nothing was seen."""

    states: FloatArray
    """(K, S)"""
    weight: FloatArray
    """(K, S)"""
    shared: FloatArray
    """(P,) what was seen of the shared coordinates directly, or is known beforehand."""
    shared_weight: FloatArray
    """(P,)"""
    scale: FloatArray
    """(P,) by how much a shared coordinate may move."""
    state_scale: FloatArray
    """(S,) by how much a state may move."""


@dataclass(frozen=True, slots=True)
class Chain:
    """One place of the search."""

    states: FloatArray
    """(K, S)"""
    shared: FloatArray
    """(P,)"""
    tie: FloatArray
    """(S,) standard deviation of a link."""
    prediction: Prediction
    cost: float
    """chi2 of observations, links and bonds."""
    converged: bool = False


@dataclass(frozen=True, slots=True)
class Band:
    """Normal equations: blocks on the diagonal and beside it, border and corner."""

    diagonal: FloatArray
    """(K, S, S)"""
    beside: FloatArray
    """(L, S, S) of state k and state k + 1."""
    border: FloatArray
    """(K, S, P)"""
    corner: FloatArray
    """(P, P)"""
    gradient: FloatArray
    """(K, S)"""
    shared_gradient: FloatArray
    """(P,)"""


def begin(model: ChainModel, seen: Seen, states: FloatArray, shared: FloatArray, tie: FloatArray) -> Chain:
    """A chain that has not been moved yet."""
    prediction = model.predict(states, shared)
    return Chain(states, shared, tie, prediction, _cost(seen, states, shared, tie, prediction))


def tightened(seen: Seen, chain: Chain, tie: FloatArray) -> Chain:
    """The same chain with other ties (S,)."""
    cost = _cost(seen, chain.states, chain.shared, tie, chain.prediction)
    return replace(chain, tie=tie, cost=cost, converged=False)


def relaxed(model: ChainModel, seen: Seen, chain: Chain, iterations: int) -> Chain:
    """The chain after at most `iterations` steps of Levenberg and Marquardt; `converged` where nothing is gained."""
    damping = 1e-4
    for _ in range(iterations):
        band = normal_equations(seen, chain)
        for _ in range(_DAMPINGS):
            trial = _moved(model, seen, chain, band, damping)
            if trial.cost < chain.cost:
                break
            damping = max(10 * damping, 1e-4)
        else:
            return replace(chain, converged=True)
        gain, chain, damping = chain.cost - trial.cost, trial, damping / 8
        if gain < _QUIET * chain.cost:
            return replace(chain, converged=True)
    return chain


def _cost(seen: Seen, states: FloatArray, shared: FloatArray, tie: FloatArray, prediction: Prediction) -> float:
    parts = (
        (states - seen.states) * seen.weight,
        (shared - seen.shared) * seen.shared_weight,
        (states[1:] - prediction.ends) / tie,
        prediction.bonds,
    )
    cost = float(sum((part**2).sum() for part in parts))
    return cost if np.isfinite(cost) else float("inf")


def normal_equations(seen: Seen, chain: Chain) -> Band:
    """Sums over all rows at a place of the search."""
    p, loose = chain.prediction, 1 / chain.tie**2
    miss = chain.states[1:] - p.ends
    diagonal = np.einsum("kri,krj->kij", p.bonds_by_state, p.bonds_by_state)
    diagonal[:-1] += np.einsum("ksi,s,ksj->kij", p.by_state, loose, p.by_state)
    diagonal[1:] += np.diag(loose)
    index = np.arange(diagonal.shape[1])
    diagonal[:, index, index] += seen.weight**2
    border = np.einsum("kri,krp->kip", p.bonds_by_state, p.bonds_by_shared)
    border[:-1] += np.einsum("ksi,s,ksp->kip", p.by_state, loose, p.by_shared)
    border[1:] -= loose[:, None] * p.by_shared
    corner = np.einsum("ksp,s,ksq->pq", p.by_shared, loose, p.by_shared)
    corner += np.einsum("krp,krq->pq", p.bonds_by_shared, p.bonds_by_shared) + np.diag(seen.shared_weight**2)
    gradient = seen.weight**2 * (chain.states - seen.states) + np.einsum("kri,kr->ki", p.bonds_by_state, p.bonds)
    gradient[:-1] -= np.einsum("ksi,s,ks->ki", p.by_state, loose, miss)
    gradient[1:] += loose * miss
    shared_gradient = seen.shared_weight**2 * (chain.shared - seen.shared)
    shared_gradient = shared_gradient - np.einsum("ksp,s,ks->p", p.by_shared, loose, miss)
    shared_gradient += np.einsum("krp,kr->p", p.bonds_by_shared, p.bonds)
    beside = -np.swapaxes(p.by_state, 1, 2) * loose
    return Band(diagonal, beside, border, corner, gradient, shared_gradient)


def information(band: Band) -> FloatArray:
    """(P, P) what is known of the shared coordinates, all states unknown."""
    inside = _banded(band, np.zeros(band.gradient.shape[1]), band.border)
    return np.asarray(band.corner - np.einsum("ksp,ksq->pq", band.border, inside), np.float64)


def state_covariance(band: Band, shared: FloatArray) -> FloatArray:
    """(S, S) of the first state, given the covariance (P, P) of the shared coordinates."""
    count, size, _ = band.border.shape
    units = np.zeros((count, size, size))
    units[0] = np.eye(size)
    none = np.zeros(size)
    inner, response = _banded(band, none, units)[0], _banded(band, none, band.border)[0]
    return np.asarray(inner + response @ shared @ response.T, np.float64)


def _moved(model: ChainModel, seen: Seen, chain: Chain, band: Band, damping: float) -> Chain:
    try:
        states, shared = _step(seen, band, damping)
    except LinAlgError:
        return replace(chain, cost=float("inf"))
    there = model.allowed(chain.shared + shared)
    moved = chain.states + states
    prediction = model.predict(moved, there)
    return Chain(moved, there, chain.tie, prediction, _cost(seen, moved, there, chain.tie, prediction))


def _step(seen: Seen, band: Band, damping: float) -> tuple[FloatArray, FloatArray]:
    """Of states (K, S) and shared coordinates (P,), bounded in the scales of what is shared."""
    right = np.concatenate([band.border, band.gradient[:, :, None]], axis=2)
    inside = _banded(band, damping * float((seen.weight**2).max()) * _pull(seen), right)
    whole = band.corner - np.einsum("ksp,ksq->pq", band.border, inside[:, :, :-1])
    whole += np.diag(damping * np.diag(band.corner) + _RIDGE * np.diag(band.corner) + 1e-3 * damping / seen.scale**2)
    push = -band.shared_gradient + np.einsum("ksp,ks->p", band.border, inside[:, :, -1])
    size = 1 / np.sqrt(np.diag(whole).clip(1e-300))
    shared = size * np.linalg.solve(whole * size * size[:, None], push * size)
    shared = shared / max(1.0, float(np.max(np.abs(shared) / seen.scale, initial=0.0)) / LONGEST_STEP)
    return -(inside[:, :, -1] + inside[:, :, :-1] @ shared), shared


def _pull(seen: Seen) -> FloatArray:
    """(S,) what damping holds the numbers of a state with, relative to an observation of a place."""
    return np.asarray(np.square(seen.state_scale.min() / seen.state_scale), np.float64)


def _banded(band: Band, extra: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (K, S, Q) of the equations of the states with `right` (K, S, Q), `extra` (S,) on the diagonal."""
    count, size, columns = right.shape
    stored = np.zeros((2 * size, count * size))
    i, j = np.indices((size, size))
    low = i >= j
    base = size * np.arange(count)[:, None, None]
    blocks = band.diagonal + np.diag(extra + _RIDGE * band.diagonal.max(axis=(0, 1)))
    stored[(i - j)[low], (base + j)[:, low]] = blocks[:, low]
    stored[i - j + size, base[:-1] + j] = np.swapaxes(band.beside, 1, 2)
    flat = solveh_banded(stored, right.reshape(count * size, columns), lower=True, check_finite=False)
    return np.asarray(flat, np.float64).reshape(right.shape)
