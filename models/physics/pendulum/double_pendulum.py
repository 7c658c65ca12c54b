"""Two rigid arms on two joints: the compound double pendulum, with friction of several kinds.

Angles are absolute, rad, 0 hanging, counter-clockwise. Every equation is divided by the inertia of the first arm with
the second one's mass at its end, A = I1 + m2 L1^2 about the first joint, as only ratios can be told from motion
(Landau and Lifshitz, Mechanics, section 5, for the energies).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.integrators import DOP853, Tableau

Numbers = NDArray[np.float64] | NDArray[np.complex128]

NAMES = ("coupling", "inertia", "weight 1", "weight 2", "viscous 1", "viscous 2", "dry 1", "dry 2", "drag 1", "drag 2")
"""coupling: m2 L1 a2 / A; inertia: of the second arm about its joint, over A; weights: first moments times g, over A,
1/s^2; viscous: 1/s; dry: 1/s^2; drag with speed squared: 1. Each friction acts between an arm and what carries it; drag
acts on an arm through the air."""
LIKELY = np.array([0.35, 0.3, 70.0, 25.0, 0.05, 0.02, 0.0, 0.0, 0.0, 0.0])
"""of arms of a hand's length."""
CREEP = 0.05
"""rad/s below which dry friction turns over smoothly."""
RADIANS_PER_STEP = 0.2
"""an arm may turn in one step."""
SLOWEST = 8.0
"""rad/s that steps are made for at least: how fast short arms swing."""
COMPLEX_STEP = 1e-30


def rate(state: Numbers, numbers: Numbers) -> Numbers:
    """Derivative by time of states (4, ...): two angles, two angular velocities; numbers (10, ...)."""
    first, second, w1, w2 = state
    coupling, inertia, weight1, weight2, viscous1, viscous2, dry1, dry2, drag1, drag2 = numbers
    sine, cosine = np.sin(first - second), np.cos(first - second)
    apart = w2 - w1
    joint = viscous2 * apart + dry2 * np.tanh(apart / CREEP)
    push1 = -coupling * sine * w2**2 - weight1 * np.sin(first) - viscous1 * w1 - dry1 * np.tanh(w1 / CREEP) + joint
    push1 = push1 - drag1 * w1 * w1 * np.sign(w1.real)
    push2 = coupling * sine * w1**2 - weight2 * np.sin(second) - joint - drag2 * w2 * w2 * np.sign(w2.real)
    determinant = inertia - (coupling * cosine) ** 2
    return np.stack([
        w1, w2, (inertia * push1 - coupling * cosine * push2) / determinant,
        (push2 - coupling * cosine * push1) / determinant,
    ])  # fmt: skip


def moved(state: Numbers, numbers: Numbers, spans: FloatArray, method: Tableau = DOP853) -> Numbers:
    """States (4, K, ...) after `spans` (K, ...) s."""
    fastest = max(float(np.abs(state[2:].real).max(initial=0.0)), SLOWEST)
    count = max(1, int(np.ceil(float(np.abs(spans).max(initial=0.0)) * min(fastest, 100.0) / RADIANS_PER_STEP)))
    dt = spans / count
    for _ in range(count):
        stages: list[Numbers] = []
        for shares in method.a:
            place = state
            for share, stage in zip(shares, stages, strict=False):
                if share:
                    place = place + (dt * share) * stage
            stages.append(rate(place, numbers))
        state = state + dt * sum(share * stage for share, stage in zip(method.b, stages, strict=True) if share)
    return state


def flow(states: FloatArray, numbers: FloatArray, spans: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ends (K, 4) of states (K, 4) after `spans` (K,), slopes (K, 4, 4) by the start and (K, 4, 10) by the numbers."""
    count, inputs = len(states), 4 + len(numbers)
    shifted = np.repeat(np.concatenate([states, np.broadcast_to(numbers, (count, len(numbers)))], axis=1)[:, :, None],
                        inputs, axis=2).astype(np.complex128)  # (K, inputs, direction)  # fmt: skip
    shifted += 1j * COMPLEX_STEP * np.eye(inputs)
    turned = np.moveaxis(shifted, 1, 0)
    ends = moved(turned[:4], turned[4:], spans[:, None])  # (4, K, direction)
    slopes = np.moveaxis(ends.imag, 0, 1) / COMPLEX_STEP
    return ends[:, :, 0].real.T, slopes[:, :, :4], slopes[:, :, 4:]


def energy(state: FloatArray, numbers: FloatArray) -> FloatArray:
    """Over A, of states (4, ...)."""
    first, second, w1, w2 = state
    coupling, inertia, weight1, weight2 = numbers[:4]
    moving = 0.5 * w1**2 + 0.5 * inertia * w2**2 + coupling * w1 * w2 * np.cos(first - second)
    return np.asarray(moving - weight1 * np.cos(first) - weight2 * np.cos(second), np.float64)
