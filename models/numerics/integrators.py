"""The Runge-Kutta loop of fixed steps: Dormand and Prince's method of order 8, in 12 stages.

Hairer, Norsett, Wanner 1993, "Solving Ordinary Differential Equations I", section II.5.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import integrate

from models.numerics.jit import compile_kernel

# (13, 12) weight of the rate of stage l in the state of stage k, l < k; in the last row, in the state after the step.
_WEIGHTS = np.vstack([integrate.DOP853.A, integrate.DOP853.B])


def build_step_loop(fill_rate: Callable[..., Any]) -> Any:
    """Build the compiled loop of steps of an autonomous motion.

    Args:
        fill_rate: Compiled function of a state (n,), a tuple of arguments and the array (n,) that receives the rate.

    Returns:
        Compiled function of a state (n,), float64 or complex128, which it moves, the arguments of `fill_rate`, the
        length of a step and the number of steps.
    """

    @compile_kernel
    def take_steps(state, arguments, dt, steps):  # type: ignore[no-untyped-def]
        count, size = _WEIGHTS.shape[1], len(state)
        rates, at = np.zeros((count, size), state.dtype), np.empty_like(state)
        for _ in range(steps):
            for stage in range(count + 1):
                at[:] = state
                for earlier in range(stage):
                    weight = dt * _WEIGHTS[stage, earlier]
                    if weight != 0.0:
                        for k in range(size):
                            at[k] += weight * rates[earlier, k]
                if stage < count:
                    fill_rate(at, arguments, rates[stage])
            state[:] = at

    return take_steps
