"""The compound double pendulum: two rigid arms on two joints, with friction of several kinds.

Angles are absolute, rad, 0 hanging, counter-clockwise. Every equation is divided by the inertia of the first arm with
the mass of the second one at its end, A = I1 + m2 L1^2 about the first joint, because motion identifies only ratios
(Landau and Lifshitz, Mechanics, section 5, for the energies).

No model of a real joint is exact. Links between samples therefore have the standard deviation of their residuals,
instead of forming one motion to rounding; between two samples, the motions from both are blended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
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
from models.numerics.integrators import build_step_loop
from models.numerics.jit import COMPLEX_STEP, compile_kernel
from models.numerics.least_squares import invert_semidefinite

RealOrComplex = NDArray[np.float64] | NDArray[np.complex128]

# coupling: m2 L1 a2 / A; inertia: that of the second arm about its joint, over A; weights: first moments times g, over
# A, 1/s^2; viscous: 1/s; dry: 1/s^2; drag with speed squared: 1. Each friction acts between an arm and its support;
# drag acts on an arm through the air.
PENDULUM_PARAMETERS = (
    "coupling",
    "inertia",
    "weight 1",
    "weight 2",
    "viscous 1",
    "viscous 2",
    "dry 1",
    "dry 2",
    "drag 1",
    "drag 2",
)
# Values for arms as long as a hand.
TYPICAL_PARAMETERS = np.array([0.35, 0.3, 70.0, 25.0, 0.05, 0.02, 0.0, 0.0, 0.0, 0.0])
# rad/s; below this rate dry friction changes its sign smoothly.
DRY_FRICTION_WIDTH = 0.05
# rad that an arm may turn in one step.
RADIANS_PER_STEP = 0.2
# rad/s; steps are at least short enough for this rate, that of swinging short arms.
LEAST_STEP_RATE = 8.0


@compile_kernel
def _smooth_sign(x):  # type: ignore[no-untyped-def]
    """Return the hyperbolic tangent, with the derivative that x carries; numba's own overflows at complex numbers."""
    sign = np.tanh(x.real)
    return sign + (1 - sign * sign) * (x - x.real)


@compile_kernel
def fill_pendulum_rate(state, numbers, rate):  # type: ignore[no-untyped-def]
    """Write the time derivative (4,) of a state.

    Args:
        state: (4,) two angles (rad), two angular velocities (rad/s); real or complex.
        numbers: (10,) values of `PENDULUM_PARAMETERS`.
        rate: (4,) receives the derivative.
    """
    first, second, w1, w2 = state
    coupling, inertia, weight1, weight2, viscous1, viscous2, dry1, dry2, drag1, drag2 = numbers
    sine, cosine = np.sin(first - second), np.cos(first - second)
    apart = w2 - w1
    joint = viscous2 * apart + dry2 * _smooth_sign(apart / DRY_FRICTION_WIDTH)
    pivot = viscous1 * w1 + dry1 * _smooth_sign(w1 / DRY_FRICTION_WIDTH) + drag1 * w1 * w1 * np.sign(w1.real)
    push1 = joint - pivot - coupling * sine * w2 * w2 - weight1 * np.sin(first)
    push2 = coupling * sine * w1 * w1 - weight2 * np.sin(second) - joint - drag2 * w2 * w2 * np.sign(w2.real)
    determinant = inertia - coupling * cosine * coupling * cosine
    rate[0], rate[1] = w1, w2
    rate[2] = (inertia * push1 - coupling * cosine * push2) / determinant
    rate[3] = (push2 - coupling * cosine * push1) / determinant


_take_pendulum_steps = build_step_loop(fill_pendulum_rate)


@compile_kernel
def _advance_states(states, numbers, spans, count):  # type: ignore[no-untyped-def]
    for k in range(len(states)):
        _take_pendulum_steps(states[k], numbers[k], spans[k] / count, count)


def advance_pendulum(states: RealOrComplex, numbers: RealOrComplex, spans: FloatArray) -> RealOrComplex:
    """Integrate states over time.

    Args:
        states: (K, 4) two angles (rad), two angular velocities (rad/s); real or complex.
        numbers: (K, 10) values of `PENDULUM_PARAMETERS`.
        spans: (K,) s.

    Returns:
        (K, 4) states at the end.
    """
    fastest = max(float(np.abs(states[:, 2:].real).max(initial=0.0)), LEAST_STEP_RATE)
    count = max(1, int(np.ceil(float(np.abs(spans).max(initial=0.0)) * min(fastest, 100.0) / RADIANS_PER_STEP)))
    ends = states.copy()
    _advance_states(ends, np.ascontiguousarray(numbers), spans, count)
    return ends


def differentiate_pendulum(
    states: FloatArray, numbers: FloatArray, spans: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrate states over time, with derivatives.

    Args:
        states: (K, 4) states.
        numbers: (10,) values of `PENDULUM_PARAMETERS`.
        spans: (K,) s.

    Returns:
        Ends (K, 4), and their derivatives (K, 4, 4) by the state and (K, 4, 10) by the parameters.
    """
    count, inputs = len(states), 4 + len(numbers)
    plain = np.concatenate([states, np.broadcast_to(numbers, (count, len(numbers)))], axis=1)
    shifted = (plain[:, None] + 1j * COMPLEX_STEP * np.eye(inputs)).reshape(-1, inputs)  # (K directions, inputs)
    ends = advance_pendulum(shifted[:, :4], shifted[:, 4:], np.repeat(spans, inputs)).reshape(count, inputs, 4)
    slopes = ends.imag.swapaxes(1, 2) / COMPLEX_STEP
    return ends[:, 0].real, slopes[:, :, :4], slopes[:, :, 4:]


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
    """(10,) as in `models.estimation.springs.double_pendulum`."""
    sigma: FloatArray
    """(10,) standard deviations of the parameters."""

    def states_at(self, t: FloatArray) -> FloatArray:
        """Compute the states (M, 4) at times between the first and the last sample, or after it."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        following = np.minimum(k + 1, len(self.t) - 1)
        numbers = np.broadcast_to(self.parameters, (len(t), len(self.parameters)))
        ahead = advance_pendulum(self.states[k], numbers, t - self.t[k])
        back = advance_pendulum(self.states[following], numbers, np.minimum(t - self.t[following], 0.0))
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
