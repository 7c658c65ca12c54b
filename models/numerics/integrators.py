"""Steps through time, as data: Runge-Kutta tableaus, explicit and implicit, and the symplectic Euler step.

A state is an array (2, ...): places first, velocities second. A rate takes a state to its derivative by time. Explicit
methods and symplectic Euler only evaluate it; implicit ones solve for their stages by Newton's method and stay stable
however stiff a spring is. Hairer, Norsett, Wanner 1993, "Solving Ordinary Differential Equations I", chapter II.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import integrate as ivp

from models.core.typing import FloatArray

Rate = Callable[[FloatArray], FloatArray]
"""State (2, ...) to its derivative by time, (2, ...)."""
Slope = Callable[[FloatArray], FloatArray]
"""State (2, ...) to the Jacobian (S, S) of its rate, both flat."""

NEWTON_STEPS = 20
NEWTON_ENOUGH = 1e-12
"""of the size of the state: where Newton's method stops."""


@dataclass(frozen=True, slots=True)
class Tableau:
    """A Runge-Kutta method; explicit where `a` is strictly lower triangular."""

    name: str
    order: int
    a: FloatArray
    """(K, K) share of stage l's rate in the state of stage k."""
    b: FloatArray
    """(K,) share of each stage's rate in the step."""

    @property
    def explicit(self) -> bool:
        return not np.any(np.triu(self.a))


@dataclass(frozen=True, slots=True)
class SymplecticEuler:
    """Velocities first, then places with the new velocities: keeps phase space volume where forces know no speed."""

    name: str = "symplectic Euler"
    order: int = 1


EULER = Tableau("explicit Euler", 1, np.zeros((1, 1)), np.ones(1))
"""Chen 2022, eqs 8 and 9."""
SYMPLECTIC_EULER = SymplecticEuler()
RK4 = Tableau(
    "RK4", 4, np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]]), np.array([1, 2, 2, 1]) / 6
)
"""Chen 2022, eqs 12 to 16, with half steps in time where half steps are meant."""
DOP853 = Tableau("DOP853", 8, np.array(ivp.DOP853.A), np.array(ivp.DOP853.B))
"""Dormand and Prince's method of order 8 in 12 stages; Hairer, Norsett, Wanner 1993, section II.5."""
IMPLICIT_MIDPOINT = Tableau("implicit midpoint", 2, np.full((1, 1), 0.5), np.ones(1))
"""Symplectic and stable at any step; a stiff undamped spring keeps swinging, at a wrong frequency."""
RADAU = Tableau("Radau IIA", 3, np.array([[5, -1], [9, 3]]) / 12, np.array([0.75, 0.25]))
"""L-stable: what is too fast for the step dies out. Hairer and Wanner 1996, table IV.5.5."""

Method = Tableau | SymplecticEuler
METHODS: tuple[Method, ...] = (EULER, SYMPLECTIC_EULER, RK4, DOP853, IMPLICIT_MIDPOINT, RADAU)


def step(method: Method, rate: Rate, state: FloatArray, dt: float, slope: Slope | None = None) -> FloatArray:
    """State (2, ...) after `dt` s. Implicit methods need the `slope` of the rate.

    Raises `ArithmeticError` where Newton's method finds no stages: the step is too long.
    """
    if isinstance(method, SymplecticEuler):
        return _symplectic(rate, state, dt)
    stages = _explicit_stages(method, rate, state, dt) if method.explicit else _solved(method, rate, slope, state, dt)
    return state + dt * np.tensordot(method.b, stages, axes=1)


def path(
    method: Method, rate: Rate, state: FloatArray, t: FloatArray, longest: float, slope: Slope | None = None
) -> FloatArray:  # fmt: skip
    """States (T, 2, ...) at times `t` (T,) s, of which the first is that of `state`; steps are at most `longest` s."""
    states = [state]
    for span in np.diff(t):
        count = max(1, int(np.ceil(abs(span) / longest - 1e-9)))
        for _ in range(count):
            state = step(method, rate, state, float(span) / count, slope)
        states.append(state)
    return np.array(states)


def _symplectic(rate: Rate, state: FloatArray, dt: float) -> FloatArray:
    v = state[1] + dt * rate(state)[1]
    return np.stack([state[0] + dt * v, v])


def _explicit_stages(method: Tableau, rate: Rate, state: FloatArray, dt: float) -> FloatArray:
    stages = np.zeros((len(method.b), *state.shape))
    for k, shares in enumerate(method.a):
        stages[k] = rate(state + dt * np.tensordot(shares[:k], stages[:k], axes=1))
    return stages


def _solved(method: Tableau, rate: Rate, slope: Slope | None, state: FloatArray, dt: float) -> FloatArray:
    """Rates (K, 2, ...) of the stages of an implicit method."""
    if slope is None:
        raise ValueError(f"{method.name} is implicit; give the slope of the rate, or use an explicit method")
    count, size = len(method.b), state.size
    stages = np.repeat(rate(state)[None], count, axis=0)
    for _ in range(NEWTON_STEPS):
        places = state + dt * np.tensordot(method.a, stages, axes=1)
        miss = stages - np.array([rate(place) for place in places])
        slopes = np.array([slope(place) for place in places])  # (K, S, S)
        jacobian = np.eye(count * size) - dt * np.einsum("kl,kij->kilj", method.a, slopes).reshape(count * size, -1)
        change = np.linalg.solve(jacobian, miss.ravel()).reshape(stages.shape)
        stages = stages - change
        if dt * np.abs(change).max() <= NEWTON_ENOUGH * (1 + np.abs(state).max()):
            return stages
    raise ArithmeticError(f"{method.name} found no stages for a step of {dt:g} s; take a shorter one")
