"""One step in time through a learnt slope: Euler and Runge-Kutta as the thesis has them, and symplectic ones."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Slope = Callable[[Tensor, Tensor], Tensor]
"""(x (..., C), t (..., 1)) to dx/dt (..., C)."""
Step = Callable[[Slope, Tensor, Tensor, Tensor], Tensor]
"""(slope, x (..., C), t (..., 1), h (..., 1)) to x at t + h."""


def euler(slope: Slope, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
    """Chen 2022, eq. 11: order 1."""
    return x + h * slope(x, t)


def runge_kutta(slope: Slope, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
    """Chen 2022, eqs 12 to 16, with the slopes taken where they belong: at t, t + h/2 and t + h. Order 4."""
    return _runge_kutta(slope, x, t, h, h)


def printed_runge_kutta(slope: Slope, x: Tensor, t: Tensor, h: Tensor) -> Tensor:
    """Chen 2022, eqs 12 to 19 to the letter: slopes at t + 0.5 and t + 1 steps though x moves by half a step only.

    A network can learn to live with the shift, but the step is then not of order 4.
    """
    return _runge_kutta(slope, x, t, h, 2 * h)


def _runge_kutta(slope: Slope, x: Tensor, t: Tensor, h: Tensor, ahead: Tensor) -> Tensor:
    k1 = slope(x, t)
    k2 = slope(x + h / 2 * k1, t + ahead / 2)
    k3 = slope(x + h / 2 * k2, t + ahead / 2)
    k4 = slope(x + h * k3, t + ahead)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def leapfrog(slope: Slope, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
    """Kick, drift, kick of z = (q, p) (..., 2 C), where dq/dt knows p only and dp/dt q only. Symplectic, order 2."""
    half = z.shape[-1] // 2
    drift, kick = torch.ones_like(z), torch.ones_like(z)
    drift[..., half:], kick[..., :half] = 0.0, 0.0
    z = z + h / 2 * kick * slope(z, t)
    z = z + h * drift * slope(z, t)
    return z + h / 2 * kick * slope(z, t)


OUTER = 1 / (2 - 2 ** (1 / 3))


def yoshida(slope: Slope, z: Tensor, t: Tensor, h: Tensor) -> Tensor:
    """Three steps of `leapfrog`, the middle one backwards: symplectic, order 4 (Yoshida 1990, doi
    10.1016/0375-9601(90)90092-3)."""
    for share in (OUTER, 1 - 2 * OUTER, OUTER):
        z, t = leapfrog(slope, z, t, share * h), t + share * h
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
    while count < most:
        count *= 2
        before, found = found, march(step, slope, z, t, h, count)
        if not (found - before).abs().max() > tolerance:
            break
    return found
