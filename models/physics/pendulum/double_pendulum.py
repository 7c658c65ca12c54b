"""The compound double pendulum: two rigid arms on two joints, with friction of several kinds.

Angles are absolute, rad, 0 hanging, counter-clockwise. Every equation is divided by the inertia of the first arm with
the mass of the second one at its end, A = I1 + m2 L1^2 about the first joint, because motion identifies only ratios
(Landau and Lifshitz, Mechanics, section 5, for the energies).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.integrators import DOP853_STAGES, DOP853_WEIGHTS

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
COMPLEX_STEP = 1e-30


def evaluate_pendulum_rate(state: RealOrComplex, numbers: RealOrComplex) -> RealOrComplex:
    """Evaluate the time derivative of states.

    Args:
        state: (4, ...) two angles (rad), two angular velocities (rad/s).
        numbers: (10, ...) values of `PENDULUM_PARAMETERS`.

    Returns:
        (4, ...) derivative.
    """
    first, second, w1, w2 = state
    coupling, inertia, weight1, weight2, viscous1, viscous2, dry1, dry2, drag1, drag2 = numbers
    sine, cosine = np.sin(first - second), np.cos(first - second)
    apart = w2 - w1
    joint = viscous2 * apart + dry2 * np.tanh(apart / DRY_FRICTION_WIDTH)
    push1 = (
        -coupling * sine * w2**2
        - weight1 * np.sin(first)
        - viscous1 * w1
        - dry1 * np.tanh(w1 / DRY_FRICTION_WIDTH)
        + joint
    )
    push1 = push1 - drag1 * w1 * w1 * np.sign(w1.real)
    push2 = coupling * sine * w1**2 - weight2 * np.sin(second) - joint - drag2 * w2 * w2 * np.sign(w2.real)
    determinant = inertia - (coupling * cosine) ** 2
    return np.stack([
        w1, w2, (inertia * push1 - coupling * cosine * push2) / determinant,
        (push2 - coupling * cosine * push1) / determinant,
    ])  # fmt: skip


def advance_pendulum(state: RealOrComplex, numbers: RealOrComplex, spans: FloatArray) -> RealOrComplex:
    """Integrate states over time.

    Args:
        state: (4, K, ...) two angles (rad), two angular velocities (rad/s); real or complex.
        numbers: (10, ...) values of `PENDULUM_PARAMETERS`.
        spans: (K, ...) s.

    Returns:
        (4, K, ...) states at the end.
    """
    fastest = max(float(np.abs(state[2:].real).max(initial=0.0)), LEAST_STEP_RATE)
    count = max(1, int(np.ceil(float(np.abs(spans).max(initial=0.0)) * min(fastest, 100.0) / RADIANS_PER_STEP)))
    dt = spans / count
    for _ in range(count):
        stages: list[RealOrComplex] = []
        for shares in DOP853_STAGES:
            place = state
            for share, stage in zip(shares, stages, strict=False):
                if share:
                    place = place + (dt * share) * stage
            stages.append(evaluate_pendulum_rate(place, numbers))
        state = state + dt * sum(share * stage for share, stage in zip(DOP853_WEIGHTS, stages, strict=True) if share)
    return state


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
    shifted = np.repeat(np.concatenate([states, np.broadcast_to(numbers, (count, len(numbers)))], axis=1)[:, :, None],
                        inputs, axis=2).astype(np.complex128)  # (K, inputs, direction)  # fmt: skip
    shifted += 1j * COMPLEX_STEP * np.eye(inputs)
    turned = np.moveaxis(shifted, 1, 0)
    ends = advance_pendulum(turned[:4], turned[4:], spans[:, None])  # (4, K, direction)
    slopes = np.moveaxis(ends.imag, 0, 1) / COMPLEX_STEP
    return ends[:, :, 0].real.T, slopes[:, :, :4], slopes[:, :, 4:]
