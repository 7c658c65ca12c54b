"""Priors of a segment: speed, initial slip, and extra acceleration.

Rows of pseudo-observations are appended to `output`: values (M,), derivatives, their columns, and the first entry of
each row, as the fields of `models.estimation.joint_fit.prior_residuals.PriorRows`.
"""

from __future__ import annotations

import numpy as np

from models.estimation.joint_fit.fit_arrays import BREAK, FREE, JUMP, NONE, STRIKE
from models.numerics.jit import compile_kernel

# m/s^2 per axis: slope, nap and drag, per segment.
EXTRA_ACCELERATION_SIGMA = 0.02
# Slip of a ball that begins to move for an unknown cause: share of its speed, and m/s.
UNEXPLAINED_SLIP_SIGMA = 0.7, 0.2
# Standard deviation of the slip after a strike, about that of a ball hit in its middle: share of the speed along the
# path and across it, and m/s. A central hit gives no spin, so that the ball slips with all its velocity; a hit a fifth
# of a radius above or below takes or adds half of that. Across the path only a raised cue makes a ball slip (Coriolis
# 1835).
STRUCK_SLIP, SWERVE_SLIP, LEAST_SLIP = 0.5, 0.25, 0.1
# m/s: prior standard deviation of a velocity.
_VELOCITY_SIGMA = 5.0


@compile_kernel
def append_segment_priors(arrays, segment, state, reference_state, output, count):  # type: ignore[no-untyped-def]
    """Append the priors of slip, extra acceleration and velocity; those of slip after a contact are in its rows."""
    start, column = arrays.start[segment], arrays.column[segment]
    speed = np.hypot(reference_state[2], reference_state[3])
    if start == NONE or arrays.kind[start] in (FREE, JUMP, BREAK):
        for k in (4, 5):
            sigma = UNEXPLAINED_SLIP_SIGMA[0] * speed + UNEXPLAINED_SLIP_SIGMA[1]
            count = append_prior_row(output, count, state[k] / sigma, column + k, 1 / sigma)
    elif arrays.kind[start] == STRIKE and not arrays.pushed[start]:
        count = _append_strike_priors(state, reference_state, column, output, count)
    for k in (2, 3, 6, 7):
        sigma = _VELOCITY_SIGMA if k < 4 else EXTRA_ACCELERATION_SIGMA
        count = append_prior_row(output, count, state[k] / sigma, column + k, 1 / sigma)
    return count


@compile_kernel
def _append_strike_priors(state, reference_state, column, output, count):  # type: ignore[no-untyped-def]
    """Append the prior of slip after a strike: equal to the velocity, uncertain along the path, hardly across it."""
    speed = np.hypot(reference_state[2], reference_state[3])
    direction = (reference_state[2] / speed, reference_state[3] / speed) if speed > 0 else (1.0, 0.0)
    for share, (x, y) in ((STRUCK_SLIP, direction), (SWERVE_SLIP, (-direction[1], direction[0]))):
        sigma = share * speed + LEAST_SLIP
        output[0][count] = ((state[4] - state[2]) * x + (state[5] - state[3]) * y) / sigma
        position = output[3][count]
        for k, component in ((4, x), (5, y), (2, -x), (3, -y)):
            position = append_derivative(output, position, column + k, component / sigma)
        count += 1
        output[3][count] = position
    return count


@compile_kernel
def append_prior_row(output, count, value, column, derivative):  # type: ignore[no-untyped-def]
    """Append a row that depends on one parameter only."""
    output[0][count] = value
    output[3][count + 1] = append_derivative(output, output[3][count], column, derivative)
    return count + 1


@compile_kernel
def append_derivative(output, position, column, derivative):  # type: ignore[no-untyped-def]
    """Append one derivative to the current row if it is not zero."""
    if derivative != 0.0:
        output[1][position], output[2][position] = derivative, column
        position += 1
    return position
