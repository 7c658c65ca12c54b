"""Integration steps through a learned vector field: Euler and Runge-Kutta of Chen 2022, and symplectic steps.

Steps are frozen dataclasses, so that they can be options of a method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

# Maps a state x (..., C) and times t (..., 1) to dx/dt (..., C).
VectorField = Callable[[Tensor, Tensor], Tensor]


class IntegrationStep(Protocol):
    """A one-step integration method."""

    def __call__(self, field: VectorField, x: Tensor, t: Tensor, h: Tensor, /) -> Tensor:
        """Advance the state x (..., C) from t to t + h; times are (..., 1), in steps."""


@dataclass(frozen=True, slots=True)
class EulerStep:
    """Explicit Euler step of order 1 (Chen 2022, eq. 11)."""

    def __call__(self, field: VectorField, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """Evaluate the field once, at the start of the step."""
        return x + h * field(x, t)


@dataclass(frozen=True, slots=True)
class RungeKuttaStep:
    """Classical Runge-Kutta step (Chen 2022, eqs 12 to 16): order 4, with slopes at t, t + h/2 and t + h.

    As printed, Chen 2022, eqs 12 to 19 evaluate the slopes at t + 0.5 and t + 1 steps, although x advances by half a
    step only. This corresponds to `time_factor` = 2. The order is then 1, but a network can adapt to it.
    """

    time_factor: float = 1.0
    """Time of the last slope after t, as a multiple of h."""

    def __call__(self, field: VectorField, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """Evaluate the field four times."""
        ahead = self.time_factor * h
        k1 = field(x, t)
        k2 = field(x + h / 2 * k1, t + ahead / 2)
        k3 = field(x + h / 2 * k2, t + ahead / 2)
        k4 = field(x + h * k3, t + ahead)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass(frozen=True, slots=True)
class LeapfrogStep:
    """Kick, drift and kick of z = (q, p): symplectic, order 2. dq/dt must depend on p only and dp/dt on q only."""

    def __call__(self, field: VectorField, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """Advance z (..., 2 C) from t to t + h."""
        half = z.shape[-1] // 2
        drift, kick = torch.ones_like(z), torch.ones_like(z)
        drift[..., half:], kick[..., :half] = 0.0, 0.0
        z = z + h / 2 * kick * field(z, t)
        z = z + h * drift * field(z, t)
        return z + h / 2 * kick * field(z, t)


YOSHIDA_OUTER_SHARE = 1 / (2 - 2 ** (1 / 3))


@dataclass(frozen=True, slots=True)
class YoshidaStep:
    """Three steps of `LeapfrogStep`, the middle one backwards: symplectic, order 4.

    Yoshida 1990, doi:10.1016/0375-9601(90)90092-3.
    """

    def __call__(self, field: VectorField, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """Advance z (..., 2 C) from t to t + h."""
        for share in (YOSHIDA_OUTER_SHARE, 1 - 2 * YOSHIDA_OUTER_SHARE, YOSHIDA_OUTER_SHARE):
            z, t = LeapfrogStep()(field, z, t, share * h), t + share * h
        return z


def integrate_steps(step: IntegrationStep, field: VectorField, z: Tensor, t: Tensor, h: Tensor, count: int) -> Tensor:
    """Integrate from t to t + h by equal steps.

    Args:
        step: Integration step.
        field: Vector field.
        z: States (..., C) at t.
        t: Times (..., 1), steps.
        h: Durations (..., 1), steps.
        count: Number of steps.

    Returns:
        States (..., C) at t + h.
    """
    for k in range(count):
        z = step(field, z, t + k * h / count, h / count)
    return z


def integrate_to_tolerance(
    step: IntegrationStep, field: VectorField, z: Tensor, t: Tensor, h: Tensor, tolerance: float, max_count: int = 64
) -> Tensor:
    """Integrate from t to t + h, doubling the number of steps until the result converges.

    Args:
        step: Integration step.
        field: Vector field.
        z: States (..., C) at t.
        t: Times (..., 1), steps.
        h: Durations (..., 1), steps.
        tolerance: Stop when doubling changes no component by more than this.
        max_count: Largest number of steps.

    Returns:
        States (..., C) at t + h.
    """
    count = 1
    state = integrate_steps(step, field, z, t, h, count)
    while count < max_count and state.numel():
        count *= 2
        previous, state = state, integrate_steps(step, field, z, t, h, count)
        if not (state - previous).abs().max() > tolerance:
            break
    return state
