"""Fit of a real double pendulum to measured angles, and the motion between them.

No model of a real joint is exact. Links between samples therefore have the standard deviation of their residuals,
instead of forming one motion to rounding; between two samples, the motions from both are blended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import FloatArray
from models.estimation.springs.dense_shooting import (
    ChainEstimate,
    ChainObservations,
    ChainPrediction,
    build_normal_equations,
    information_of_shared,
    minimize_chain,
    start_chain,
)
from models.numerics.least_squares import invert_semidefinite
from models.physics.pendulum.double_pendulum import TYPICAL_PARAMETERS, advance_pendulum, differentiate_pendulum

# rad: noise of a good encoder, or of a marker observed from near.
ANGLE_NOISE = 1e-3
# Sigma of the first links, relative to the second difference of the angles.
FIRST_LINK_SIGMA = 1.0
STAGES = 8
ITERATIONS = 12
MIN_SAMPLES = 8
# Parameters whose logarithm is fitted.
LOGARITHMIC = slice(0, 4)
# Standard deviations of the priors, of the logarithm for the first four.
PRIOR_SIGMA = np.array([0.5, 0.7, 0.7, 0.7, 0.3, 0.3, 1.0, 1.0, 0.05, 0.05])


@dataclass(frozen=True, slots=True)
class PendulumChain:
    """Two arms as a chain of states at K samples."""

    spans: FloatArray
    """(K - 1,) s"""

    def clip_shared(self, shared: FloatArray) -> FloatArray:
        """Clip coordinates so that frictions dissipate energy and the inertia matrix stays positive."""
        clipped = shared.copy()
        clipped[4:] = np.clip(clipped[4:], 0.0, None)
        clipped[0] = min(clipped[0], 0.5 * clipped[1] - 0.02)
        return clipped

    def physical_parameters(self, shared: FloatArray) -> FloatArray:
        """Convert search coordinates into parameters (10,)."""
        values = shared.copy()
        values[LOGARITHMIC] = np.exp(shared[LOGARITHMIC])
        return values

    def predict(self, states: FloatArray, shared: FloatArray) -> ChainPrediction:
        """Predict every state at the next sample."""
        numbers = self.physical_parameters(shared)
        with np.errstate(over="ignore", invalid="ignore"):
            ends, by_state, by_shared = differentiate_pendulum(states[:-1], numbers, self.spans)
        by_shared[:, :, LOGARITHMIC] *= numbers[LOGARITHMIC]
        none = np.zeros((len(states), 0))
        return ChainPrediction(ends, by_state, by_shared, none, np.zeros((*none.shape, 4)), np.zeros((*none.shape, 10)))


@dataclass(frozen=True, slots=True)
class PendulumFit:
    """A fitted double pendulum."""

    t: FloatArray
    """(K,) s"""
    states: FloatArray
    """(K, 4) angles and angular velocities at the samples."""
    parameters: FloatArray
    """(10,) as in `models.physics.pendulum.double_pendulum`."""
    sigma: FloatArray
    """(10,) standard deviations of the parameters."""

    def states_at(self, t: FloatArray) -> FloatArray:
        """Compute the states (M, 4) at times between the first and the last sample, or after it."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        following = np.minimum(k + 1, len(self.t) - 1)
        numbers = np.broadcast_to(self.parameters[:, None], (len(self.parameters), len(t)))
        ahead = advance_pendulum(self.states[k].T, numbers, t - self.t[k]).T
        back = advance_pendulum(self.states[following].T, numbers, np.minimum(t - self.t[following], 0.0)).T
        share = np.where(following > k, (t - self.t[k]) / np.where(following > k, self.t[following] - self.t[k], 1), 0)
        weight = (share**2 * (3 - 2 * share))[:, None]
        return np.asarray((1 - weight) * ahead.real + weight * back.real, np.float64)


def fit_pendulum(t: FloatArray, angles: FloatArray) -> PendulumFit:
    """Fit a double pendulum to two absolute angles.

    Args:
        t: (K,) s, increasing.
        angles: (K, 2) rad, 0 hanging, not wrapped.

    Returns:
        The fitted pendulum.

    Raises:
        ValueError: There are too few samples, or not two angles.
    """
    if len(t) < MIN_SAMPLES or angles.shape != (len(t), 2):
        raise ValueError(f"a double pendulum needs {MIN_SAMPLES} samples of two angles; got {angles.shape}")
    model, observed, states = _build_problem(t, angles)
    span = float(np.median(np.diff(t)))
    bend = float(np.sqrt(np.mean(np.diff(angles, 2, axis=0) ** 2)))
    chain, shared = None, observed.shared
    for tie in np.geomspace(FIRST_LINK_SIGMA * bend, ANGLE_NOISE, STAGES):
        ties = np.array([tie, tie, tie / span, tie / span])
        chain = start_chain(model, observed, states, shared, ties)
        chain = minimize_chain(model, observed, chain, ITERATIONS)
        states, shared = chain.states, chain.shared
    assert chain is not None
    return _summarize_fit(t, model, observed, chain)


def _build_problem(t: FloatArray, angles: FloatArray) -> tuple[PendulumChain, ChainObservations, FloatArray]:
    states = np.concatenate([angles, CubicSpline(t, angles).derivative()(t)], axis=1)
    weight = np.zeros_like(states)
    weight[:, :2] = 1 / ANGLE_NOISE
    likely = TYPICAL_PARAMETERS.copy()
    likely[LOGARITHMIC] = np.log(likely[LOGARITHMIC])
    span = float(np.median(np.diff(t)))
    observed = ChainObservations(
        states.copy(), weight, likely, 1 / PRIOR_SIGMA, PRIOR_SIGMA, np.array([1, 1, 1 / span, 1 / span])
    )
    return PendulumChain(np.diff(t)), observed, states


def _summarize_fit(
    t: FloatArray, model: PendulumChain, observed: ChainObservations, chain: ChainEstimate
) -> PendulumFit:
    numbers = model.physical_parameters(chain.shared)
    sigma = np.sqrt(np.diag(invert_semidefinite(information_of_shared(build_normal_equations(observed, chain)))))
    sigma[LOGARITHMIC] *= numbers[LOGARITHMIC]
    return PendulumFit(t, chain.states, numbers, sigma)
