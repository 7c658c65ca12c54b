"""Integration methods as data: explicit and implicit Runge-Kutta tableaus, and symplectic Euler.

A state is an array (2, ...): positions first, velocities second. A rate function returns its time derivative. Explicit
methods and symplectic Euler only evaluate the rate. Implicit methods solve for their stages by Newton's method and stay
stable for springs of any stiffness. Hairer, Norsett, Wanner 1993, "Solving Ordinary Differential Equations I",
chapter II.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import integrate as ivp

from models.core.typing import FloatArray

RateFunction = Callable[[FloatArray], FloatArray]
"""Maps a state (2, ...) to its time derivative (2, ...)."""
RateJacobian = Callable[[FloatArray], FloatArray]
"""Maps a state (2, ...) to the Jacobian of its rate (P, P), where P is the size of the flattened state."""

MAX_NEWTON_STEPS = 20
NEWTON_TOLERANCE = 1e-12
"""Relative to the size of the state: Newton's method stops at smaller corrections."""


@dataclass(frozen=True, slots=True)
class Tableau:
    """A Runge-Kutta method; explicit where `a` is strictly lower triangular."""

    name: str
    order: int
    a: FloatArray
    """(M, M) weight of the rate of stage l in the state of stage k."""
    b: FloatArray
    """(M,) weight of the rate of each stage in the step."""

    @property
    def is_explicit(self) -> bool:
        """Whether every stage depends on earlier stages only."""
        return not np.any(np.triu(self.a))


@dataclass(frozen=True, slots=True)
class SymplecticEuler:
    """Updates velocities first, then positions with the new velocities.

    Preserves phase space volume if forces do not depend on velocities.
    """

    name: str = "symplectic Euler"
    order: int = 1


EULER = Tableau("explicit Euler", 1, np.zeros((1, 1)), np.ones(1))
"""Chen 2022, eqs 8 and 9."""
SYMPLECTIC_EULER = SymplecticEuler()
RK4 = Tableau(
    "RK4", 4, np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]]), np.array([1, 2, 2, 1]) / 6
)
"""Chen 2022, eqs 12 to 16, with the intermediate rates at half a step in time, as the method requires."""
DOP853 = Tableau("DOP853", 8, np.array(ivp.DOP853.A), np.array(ivp.DOP853.B))
"""Dormand and Prince's method of order 8 in 12 stages; Hairer, Norsett, Wanner 1993, section II.5."""
IMPLICIT_MIDPOINT = Tableau("implicit midpoint", 2, np.full((1, 1), 0.5), np.ones(1))
"""Symplectic and stable at any step; a stiff undamped spring keeps its amplitude, at a wrong frequency."""
RADAU = Tableau("Radau IIA", 3, np.array([[5, -1], [9, 3]]) / 12, np.array([0.75, 0.25]))
"""L-stable: oscillations that are too fast for the step decay. Hairer and Wanner 1996, table IV.5.5."""

IntegrationMethod = Tableau | SymplecticEuler
METHODS: tuple[IntegrationMethod, ...] = (EULER, SYMPLECTIC_EULER, RK4, DOP853, IMPLICIT_MIDPOINT, RADAU)


def take_step(
    method: IntegrationMethod, rate: RateFunction, state: FloatArray, dt: float, jacobian: RateJacobian | None = None
) -> FloatArray:
    """Advance a state by one step.

    Args:
        method: Integration method.
        rate: Rate function.
        state: State (2, ...).
        dt: Step, s.
        jacobian: Jacobian of the rate; implicit methods need it.

    Returns:
        State (2, ...) after the step.

    Raises:
        ValueError: An implicit method got no Jacobian.
        ArithmeticError: Newton's method found no stages; the step is too long.
    """
    if isinstance(method, SymplecticEuler):
        return _take_symplectic_step(rate, state, dt)
    stages = (
        _evaluate_explicit_stages(method, rate, state, dt)
        if method.is_explicit
        else _solve_implicit_stages(method, rate, jacobian, state, dt)
    )
    return state + dt * np.tensordot(method.b, stages, axes=1)


def integrate_path(
    method: IntegrationMethod, rate: RateFunction, state: FloatArray, t: FloatArray, max_step: float,
    jacobian: RateJacobian | None = None,
) -> FloatArray:  # fmt: skip
    """Integrate a motion and return its states at given times.

    Args:
        method: Integration method.
        rate: Rate function.
        state: State (2, ...) at the first time.
        t: Times (T,), s.
        max_step: Longest step, s.
        jacobian: Jacobian of the rate; implicit methods need it.

    Returns:
        States (T, 2, ...).

    Raises:
        ValueError: An implicit method got no Jacobian.
        ArithmeticError: Newton's method found no stages; the step is too long.
    """
    states = [state]
    for span in np.diff(t):
        count = max(1, int(np.ceil(abs(span) / max_step - 1e-9)))
        for _ in range(count):
            state = take_step(method, rate, state, float(span) / count, jacobian)
        states.append(state)
    return np.array(states)


def _take_symplectic_step(rate: RateFunction, state: FloatArray, dt: float) -> FloatArray:
    v = state[1] + dt * rate(state)[1]
    return np.stack([state[0] + dt * v, v])


def _evaluate_explicit_stages(method: Tableau, rate: RateFunction, state: FloatArray, dt: float) -> FloatArray:
    stages = np.zeros((len(method.b), *state.shape))
    for k, shares in enumerate(method.a):
        stages[k] = rate(state + dt * np.tensordot(shares[:k], stages[:k], axes=1))
    return stages


def _solve_implicit_stages(
    method: Tableau, rate: RateFunction, jacobian: RateJacobian | None, state: FloatArray, dt: float
) -> FloatArray:
    """Solve for the rates (M, 2, ...) of the stages of an implicit method by Newton's method."""
    if jacobian is None:
        raise ValueError(f"{method.name} is implicit; give the Jacobian of the rate, or use an explicit method")
    count, size = len(method.b), state.size
    stages = np.repeat(rate(state)[None], count, axis=0)
    for _ in range(MAX_NEWTON_STEPS):
        stage_states = state + dt * np.tensordot(method.a, stages, axes=1)
        residual = stages - np.array([rate(one) for one in stage_states])
        slopes = np.array([jacobian(one) for one in stage_states])  # (M, P, P)
        newton_matrix = np.eye(count * size) - dt * np.einsum("kl,kij->kilj", method.a, slopes).reshape(
            count * size, -1
        )
        change = np.linalg.solve(newton_matrix, residual.ravel()).reshape(stages.shape)
        stages = stages - change
        if dt * np.abs(change).max() <= NEWTON_TOLERANCE * (1 + np.abs(state).max()):
            return stages
    raise ArithmeticError(f"{method.name} found no stages for a step of {dt:g} s; take a shorter one")
