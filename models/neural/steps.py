"""One step in time through a learnt slope, as the thesis has it: Euler and Runge-Kutta."""

from __future__ import annotations

from collections.abc import Callable

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
