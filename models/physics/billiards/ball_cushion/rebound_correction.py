"""Learned correction of a cushion model: a small network with the symmetries of a cushion built in.

It adds shares of the speed before the contact to the velocity and the slip after it, so that a ball at rest stays at
rest. Mirrored contacts (vt, ut and side spin change their sign) get mirrored corrections: the network is evaluated for
both, its normal outputs are averaged, its tangential ones subtracted. A correction that would create energy is left
out. Without weights there is none.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel, copy_numbers

# vn, vt, un, ut and side spin over the speed, and the logarithm of the speed; velocity and slip along n and t.
INPUTS, HIDDEN, OUTPUTS = 6, 8, 4
# Weights and offsets of the hidden units, row by row, then the weights of the outputs.
WEIGHT_COUNT = HIDDEN * (INPUTS + 1) + OUTPUTS * HIDDEN
# The weights of a model that is not corrected.
NO_CORRECTION = np.empty(0)
# Of the speed, of any correction.
LARGEST_SHARE = 0.3
# m/s, added to the speed whose logarithm is an input.
LEAST_SPEED = 0.1
# Energy of the spin over that of the same surface speed as velocity, of a solid sphere.
_SPIN_ENERGY = 0.4


@compile_kernel
def evaluate_network(weights, x, out):  # type: ignore[no-untyped-def]
    """Write the outputs (4,) of the network for inputs x (6,)."""
    out[:] = 0.0
    for h in range(HIDDEN):
        row = h * (INPUTS + 1)
        total = weights[row + INPUTS]
        for i in range(INPUTS):
            total += weights[row + i] * x[i]
        unit = np.tanh(total)
        for o in range(OUTPUTS):
            out[o] += weights[HIDDEN * (INPUTS + 1) + o * HIDDEN + h] * unit


@compile_kernel
def rebound_energy(vn, vt, un, ut, spin):  # type: ignore[no-untyped-def]
    """Return twice the energy per mass; `spin` is the surface speed of side spin, m/s."""
    return vn * vn + vt * vt + _SPIN_ENERGY * ((ut - vt) ** 2 + (vn - un) ** 2 + spin * spin)


@compile_kernel
def correct_rebound(weights, before, after):  # type: ignore[no-untyped-def]
    """Correct the state after a contact with a cushion in place.

    Args:
        weights: (WEIGHT_COUNT,) or empty.
        before: (5,) velocity along n and t, slip along n and t, surface speed of side spin, m/s.
        after: (5,) the same after the contact by the model; corrected.
    """
    if len(weights) == 0:
        return
    speed = np.hypot(before[0], before[1])
    x, one, other = np.empty(INPUTS), np.empty(OUTPUTS), np.empty(OUTPUTS)
    for i in range(5):
        x[i] = before[i] / max(speed, 1e-9)
    x[5] = np.log(speed + LEAST_SPEED)
    evaluate_network(weights, x, one)
    x[1], x[3], x[4] = -x[1], -x[3], -x[4]
    evaluate_network(weights, x, other)
    moved = after.copy()
    for o in range(OUTPUTS):
        half = 0.5 * (one[o] + other[o]) if o % 2 == 0 else 0.5 * (one[o] - other[o])
        moved[o] += speed * LARGEST_SHARE * np.tanh(half / LARGEST_SHARE)
    limit = rebound_energy(before[0], before[1], before[2], before[3], before[4])
    if moved[0] < 0.0 and rebound_energy(moved[0], moved[1], moved[2], moved[3], moved[4]) <= limit:
        copy_numbers(moved, after)
