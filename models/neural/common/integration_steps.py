"""One step in time through a learnt slope: Euler and Runge-Kutta as the thesis has them, and symplectic ones.

Steps are values, so that a method says by its options what it does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

Slope = Callable[[Tensor, Tensor], Tensor]
"""(x (..., C), t (..., 1)) to dx/dt (..., C)."""


class Step(Protocol):
    """One rule."""

    def __call__(self, slope: Slope, x: Tensor, t: Tensor, h: Tensor, /) -> Tensor:
        """State (..., C) at t + h of one at t; times are (..., 1)."""


@dataclass(frozen=True, slots=True)
class Euler:
    """Chen 2022, eq. 11: order 1."""

    def __call__(self, slope: Slope, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """One slope, at the beginning."""
        return x + h * slope(x, t)


@dataclass(frozen=True, slots=True)
class RungeKutta:
    """Chen 2022, eqs 12 to 16: order 4 where the slopes are taken where they belong, at t, t + h/2 and t + h.

    Eqs 12 to 19 to the letter take them at t + 0.5 and t + 1 steps though x moves by half a step only: `late` is then
    2. A network can learn to live with that, but the rule is of order 1.
    """

    late: float = 1.0
    """times h: where the last slope is taken."""

    def __call__(self, slope: Slope, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """Four slopes."""
        ahead = self.late * h
        k1 = slope(x, t)
        k2 = slope(x + h / 2 * k1, t + ahead / 2)
        k3 = slope(x + h / 2 * k2, t + ahead / 2)
        k4 = slope(x + h * k3, t + ahead)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass(frozen=True, slots=True)
class Leapfrog:
    """Kick, drift, kick of z = (q, p), where dq/dt knows p only and dp/dt q only. Symplectic, order 2."""

    def __call__(self, slope: Slope, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """(..., 2 C) to the same."""
        half = z.shape[-1] // 2
        drift, kick = torch.ones_like(z), torch.ones_like(z)
        drift[..., half:], kick[..., :half] = 0.0, 0.0
        z = z + h / 2 * kick * slope(z, t)
        z = z + h * drift * slope(z, t)
        return z + h / 2 * kick * slope(z, t)


OUTER = 1 / (2 - 2 ** (1 / 3))


@dataclass(frozen=True, slots=True)
class Yoshida:
    """Three steps of `Leapfrog`, the middle one backwards: symplectic, order 4 (Yoshida 1990, doi
    10.1016/0375-9601(90)90092-3)."""

    def __call__(self, slope: Slope, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
        """(..., 2 C) to the same."""
        for share in (OUTER, 1 - 2 * OUTER, OUTER):
            z, t = Leapfrog()(slope, z, t, share * h), t + share * h
        return z


def march(step: Step, slope: Slope, z: Tensor, t: Tensor, h: Tensor, count: int) -> Tensor:
    """State at t + h by `count` equal steps."""
    for k in range(count):
        z = step(slope, z, t + k * h / count, h / count)
    return z


def settled(step: Step, slope: Slope, z: Tensor, t: Tensor, h: Tensor, tolerance: float, most: int = 64) -> Tensor:
    """State at t + h by so many steps that twice as many change nothing by more than `tolerance`, at most `most`."""
    count = 1
    found = march(step, slope, z, t, h, count)
    while count < most and found.numel():
        count *= 2
        before, found = found, march(step, slope, z, t, h, count)
        if not (found - before).abs().max() > tolerance:
            break
    return found
