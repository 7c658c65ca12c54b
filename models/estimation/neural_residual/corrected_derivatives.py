"""Corrected paths of a ball with their derivatives, exact to rounding: every input in turn gets a complex step.

States are those of `cushion_chains`: x, y (m), vx, vy, slip ux, uy and surface speed R wz of side spin (m/s).
"""

from __future__ import annotations

import numpy as np

from models.estimation.neural_residual.corrected_motion import CLOTH_WEIGHTS, ROOM, hop, travel
from models.numerics.jit import compiled
from models.physics.billiards.cloth.cloth_motion import NO_SLIP
from models.physics.billiards.cloth.motion_pieces import WIDTH
from models.physics.billiards.parameters import CUSHION_E, CUSHION_MU, ROLLING_MU, SLIDING_MU

PHYSICS = 4
"""Numbers before the noses: sliding mu, rolling mu, cushion e, cushion mu."""
NOSES = 4
_STEP = 1e-30
"""Of the complex step."""


@compiled
def spinning(start, radius, s):  # type: ignore[no-untyped-def]
    """Fill s (7,): x, y, v, w from a start (7,) that counts slip; the last slip is caught by the cloth at once."""
    ux, uy = start[4], start[5]
    s[:4] = start[:4]
    if ux.real * ux.real + uy.real * uy.real < NO_SLIP * NO_SLIP:
        s[2], s[3] = s[2] - 2.0 / 7.0 * ux, s[3] - 2.0 / 7.0 * uy
        ux, uy = 0.0 * ux, 0.0 * uy
    s[4], s[5], s[6] = (uy - s[3]) / radius, (s[2] - ux) / radius, start[6] / radius


@compiled
def slipping(s, radius, out):  # type: ignore[no-untyped-def]
    """Fill out (7,), which counts slip, from s (7,), which counts spin."""
    out[:4] = s[:4]
    out[4], out[5], out[6] = s[2] - radius * s[5], s[3] + radius * s[4], radius * s[6]


@compiled
def physics(p, shared):  # type: ignore[no-untyped-def]
    """Put the shared numbers into the vector p of parameters."""
    p[SLIDING_MU], p[ROLLING_MU], p[CUSHION_E], p[CUSHION_MU] = shared[0], shared[1], shared[2], shared[3]


@compiled
def glides(start, times, shared, neutral, radius, size, value, slope):  # type: ignore[no-untyped-def]
    """Fill value (T, 7) with states at times (T,) s after a start (7,), slope (T, 7, 7 + P) by start and shared (P,).

    Cushions, noses and what the network says of them have no part in it.
    """
    rows, phases = np.zeros((ROOM, WIDTH), np.complex128), np.zeros(ROOM, np.int64)
    s, out, one = np.empty(7, np.complex128), np.empty((len(times), 7), np.complex128), np.empty(7, np.complex128)
    slope[:] = 0.0
    for j in range(7 + len(shared)):
        k = j - 7
        if 2 <= k < PHYSICS + NOSES or k >= PHYSICS + NOSES + CLOTH_WEIGHTS:
            continue
        begin, numbers, p = start.astype(np.complex128), shared.astype(np.complex128), neutral.astype(np.complex128)
        if j < 7:
            begin[j] += 1j * _STEP
        else:
            numbers[k] += 1j * _STEP
        physics(p, numbers)
        spinning(begin, radius, s)
        travel(s, times, radius + 0j, p, numbers[PHYSICS + NOSES :], size, rows, phases, out)
        for t in range(len(times)):
            slipping(out[t], radius, one)
            value[t] = one.real
            slope[t, :, j] = one.imag / _STEP


@compiled
def hops(start, until, side, nx, ny, wall, shared, neutral, law, radius, mass, size, value, slope):  # type: ignore[no-untyped-def]
    """Fill value (7,) with the state `until` s after a start (7,), beyond the cushion `side`; slope (7, 7 + P).

    `wall` (m) is n . x of the centre of a ball that touches; whether the ball came there.
    """
    rows, phases = np.zeros((ROOM, WIDTH), np.complex128), np.zeros(ROOM, np.int64)
    s, one, met = np.empty(7, np.complex128), np.empty(7, np.complex128), True
    slope[:] = 0.0
    for j in range(7 + len(shared)):
        k = j - 7
        if PHYSICS <= k < PHYSICS + NOSES and k != PHYSICS + side:
            continue
        begin, numbers, p = start.astype(np.complex128), shared.astype(np.complex128), neutral.astype(np.complex128)
        if j < 7:
            begin[j] += 1j * _STEP
        else:
            numbers[k] += 1j * _STEP
        physics(p, numbers)
        spinning(begin, radius, s)
        came = wall - numbers[PHYSICS + side]
        met = hop(
            s, until, nx, ny, came, radius + 0j, mass + 0j, p, law, numbers[PHYSICS + NOSES :], size, rows, phases
        )
        slipping(s, radius, one)
        value[:] = one.real
        slope[:, j] = one.imag / _STEP
    return met
