"""What the angles of a real double pendulum say of it, and the motion between them.

No model of a real joint is exact, so links between samples are tied as loosely as their misfits ask for, instead of
being one motion to rounding; between two samples the motions from both are blended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import FloatArray
from models.estimation.springs.dense_shooting import (
    Chain,
    Prediction,
    Seen,
    begin,
    information,
    normal_equations,
    relaxed,
)
from models.physics.pendulum.double_pendulum import LIKELY, flow, moved

ANGLE_NOISE = 1e-3
"""rad: of a good encoder, or of a marker seen from near."""
LOOSE = 1.0
"""of the bend of the angles between samples: the first ties."""
STAGES = 8
ITERATIONS = 12
LEAST_SAMPLES = 8
POSITIVE = slice(0, 4)
"""Numbers that are sought as logarithms."""
PRIOR = np.array([0.5, 0.7, 0.7, 0.7, 0.3, 0.3, 1.0, 1.0, 0.05, 0.05])
"""standard deviations of what is likely, of the logarithm for the first four."""


@dataclass(frozen=True, slots=True)
class ArmChain:
    """Two arms as a chain of states at K samples."""

    spans: FloatArray
    """(K - 1,) s"""

    def allowed(self, shared: FloatArray) -> FloatArray:
        """Frictions take energy; the inertia matrix stays positive."""
        found = shared.copy()
        found[4:] = np.clip(found[4:], 0.0, None)
        found[0] = min(found[0], 0.5 * found[1] - 0.02)
        return found

    def numbers(self, shared: FloatArray) -> FloatArray:
        """(10,) of coordinates."""
        found = shared.copy()
        found[POSITIVE] = np.exp(shared[POSITIVE])
        return found

    def predict(self, states: FloatArray, shared: FloatArray) -> Prediction:
        """Where every state is at the next sample."""
        numbers = self.numbers(shared)
        with np.errstate(over="ignore", invalid="ignore"):
            ends, by_state, by_shared = flow(states[:-1], numbers, self.spans)
        by_shared[:, :, POSITIVE] *= numbers[POSITIVE]
        none = np.zeros((len(states), 0))
        return Prediction(ends, by_state, by_shared, none, np.zeros((*none.shape, 4)), np.zeros((*none.shape, 10)))


@dataclass(frozen=True, slots=True)
class Swing:
    """A fitted double pendulum."""

    t: FloatArray
    """(K,) s"""
    states: FloatArray
    """(K, 4) angles and angular velocities at the samples."""
    numbers: FloatArray
    """(10,) as `models.physics.pendulum.double_pendulum.NAMES`."""
    sigma: FloatArray
    """(10,)"""
    misfit: FloatArray
    """(4,) root mean square of where the motion from a sample misses the next one: rad, rad/s."""

    def at(self, t: FloatArray) -> FloatArray:
        """States (M, 4) at times between the first and the last sample, or after it."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        following = np.minimum(k + 1, len(self.t) - 1)
        numbers = np.broadcast_to(self.numbers[:, None], (len(self.numbers), len(t)))
        ahead = moved(self.states[k].T, numbers, t - self.t[k]).T
        back = moved(self.states[following].T, numbers, np.minimum(t - self.t[following], 0.0)).T
        share = np.where(following > k, (t - self.t[k]) / np.where(following > k, self.t[following] - self.t[k], 1), 0)
        weight = (share**2 * (3 - 2 * share))[:, None]
        return np.asarray((1 - weight) * ahead.real + weight * back.real, np.float64)


def swing(t: FloatArray, angles: FloatArray, noise: float = ANGLE_NOISE) -> Swing:
    """The pendulum behind two absolute angles (K, 2) rad at t (K,) s, 0 hanging, not wrapped.

    Raises `ValueError` where there are too few samples.
    """
    if len(t) < LEAST_SAMPLES or angles.shape != (len(t), 2):
        raise ValueError(f"a double pendulum needs {LEAST_SAMPLES} samples of two angles; got {angles.shape}")
    model, seen, states = _problem(t, angles, noise)
    span = float(np.median(np.diff(t)))
    bend = float(np.sqrt(np.mean(np.diff(angles, 2, axis=0) ** 2)))
    chain, shared = None, seen.shared
    for tie in np.geomspace(LOOSE * bend, noise, STAGES):
        ties = np.array([tie, tie, tie / span, tie / span])
        chain = begin(model, seen, states, shared, ties)
        chain = relaxed(model, seen, chain, ITERATIONS)
        states, shared = chain.states, chain.shared
    assert chain is not None
    return _swing(t, model, seen, chain)


def _problem(t: FloatArray, angles: FloatArray, noise: float) -> tuple[ArmChain, Seen, FloatArray]:
    states = np.concatenate([angles, CubicSpline(t, angles).derivative()(t)], axis=1)
    weight = np.zeros_like(states)
    weight[:, :2] = 1 / noise
    likely = LIKELY.copy()
    likely[POSITIVE] = np.log(likely[POSITIVE])
    span = float(np.median(np.diff(t)))
    seen = Seen(states.copy(), weight, likely, 1 / PRIOR, PRIOR, np.array([1, 1, 1 / span, 1 / span]))
    return ArmChain(np.diff(t)), seen, states


def _swing(t: FloatArray, model: ArmChain, seen: Seen, chain: Chain) -> Swing:
    numbers = model.numbers(chain.shared)
    sigma = np.sqrt(np.diag(np.linalg.inv(information(normal_equations(seen, chain)))))
    sigma[POSITIVE] *= numbers[POSITIVE]
    misfit = np.sqrt(np.mean((chain.states[1:] - chain.prediction.ends) ** 2, axis=0))
    return Swing(t, chain.states, numbers, sigma, misfit)
