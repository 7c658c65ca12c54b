"""Corrected paths of a ball with exact derivatives: every input in turn gets a complex step.

States are those of `cushion_chains`: x, y (m), vx, vy, slip ux, uy and surface speed R wz of side spin (m/s).
"""

from __future__ import annotations

import numpy as np

from models.estimation.neural_residual.corrected_motion import (
    CLOTH_WEIGHTS,
    MAX_PIECES,
    advance_past_cushion,
    advance_through_times,
)
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.cloth_motion import SLIP_THRESHOLD
from models.physics.billiards.cloth.motion_pieces import PIECE_WIDTH
from models.physics.billiards.parameter_vector import CUSHION_E, CUSHION_MU, ROLLING_MU, SLIDING_MU

PHYSICS_COUNT = 4
"""Parameters before the nose offsets: sliding friction, rolling friction, restitution, cushion friction."""
NOSE_COUNT = 4
_COMPLEX_STEP = 1e-30
"""Size of the complex step."""


@compile_kernel
def convert_slip_to_spin(start, radius, s):  # type: ignore[no-untyped-def]
    """Fill s (7,) with x, y, v, w from a start (7,) with slip; a negligible slip turns into rolling at once."""
    ux, uy = start[4], start[5]
    s[:4] = start[:4]
    if ux.real * ux.real + uy.real * uy.real < SLIP_THRESHOLD * SLIP_THRESHOLD:
        s[2], s[3] = s[2] - 2.0 / 7.0 * ux, s[3] - 2.0 / 7.0 * uy
        ux, uy = 0.0 * ux, 0.0 * uy
    s[4], s[5], s[6] = (uy - s[3]) / radius, (s[2] - ux) / radius, start[6] / radius


@compile_kernel
def convert_spin_to_slip(s, radius, out):  # type: ignore[no-untyped-def]
    """Fill out (7,), which contains slip, from s (7,), which contains spin."""
    out[:4] = s[:4]
    out[4], out[5], out[6] = s[2] - radius * s[5], s[3] + radius * s[4], radius * s[6]


@compile_kernel
def fill_parameters(p, shared):  # type: ignore[no-untyped-def]
    """Copy the shared parameters into the parameter vector p."""
    p[SLIDING_MU], p[ROLLING_MU], p[CUSHION_E], p[CUSHION_MU] = shared[0], shared[1], shared[2], shared[3]


@compile_kernel
def linearize_motion(start, times, shared, neutral, radius, size, value, slope):  # type: ignore[no-untyped-def]
    """Fill states and Jacobians of a ball that touches nothing.

    Args:
        start: (7,) start state.
        times: (T,) s after the start.
        shared: (P,) shared parameters; cushions, noses and the cushion weights of the network do not matter.
        neutral: Neutral values of all physics parameters.
        radius: m, of the ball.
        size: (2,) m, of the table.
        value: (T, 7) states, filled.
        slope: (T, 7, 7 + P) Jacobian by start and shared parameters, filled.
    """
    rows, phases = np.zeros((MAX_PIECES, PIECE_WIDTH), np.complex128), np.zeros(MAX_PIECES, np.int64)
    s, out, one = np.empty(7, np.complex128), np.empty((len(times), 7), np.complex128), np.empty(7, np.complex128)
    slope[:] = 0.0
    for j in range(7 + len(shared)):
        k = j - 7
        if 2 <= k < PHYSICS_COUNT + NOSE_COUNT or k >= PHYSICS_COUNT + NOSE_COUNT + CLOTH_WEIGHTS:
            continue
        begin, numbers, p = start.astype(np.complex128), shared.astype(np.complex128), neutral.astype(np.complex128)
        if j < 7:
            begin[j] += 1j * _COMPLEX_STEP
        else:
            numbers[k] += 1j * _COMPLEX_STEP
        fill_parameters(p, numbers)
        convert_slip_to_spin(begin, radius, s)
        advance_through_times(s, times, radius + 0j, p, numbers[PHYSICS_COUNT + NOSE_COUNT :], size, rows, phases, out)
        for t in range(len(times)):
            convert_spin_to_slip(out[t], radius, one)
            value[t] = one.real
            slope[t, :, j] = one.imag / _COMPLEX_STEP


@compile_kernel
def linearize_past_cushion(start, until, side, nx, ny, wall, shared, neutral, law, radius, mass, size, value, slope):  # type: ignore[no-untyped-def]
    """Fill the state beyond a cushion and its Jacobian.

    Args:
        start: (7,) start state.
        until: s after the start.
        side: Index of the cushion.
        nx: x component of the normal into the cushion.
        ny: y component of the normal into the cushion.
        wall: m, n . x of the centre of a ball that touches the cushion.
        shared: (P,) shared parameters.
        neutral: Neutral values of all physics parameters.
        law: Index of the cushion contact model.
        radius: m, of the ball.
        mass: kg, of the ball.
        size: (2,) m, of the table.
        value: (7,) state, filled.
        slope: (7, 7 + P) Jacobian by start and shared parameters, filled.

    Returns:
        Whether the ball reached the cushion.
    """
    rows, phases = np.zeros((MAX_PIECES, PIECE_WIDTH), np.complex128), np.zeros(MAX_PIECES, np.int64)
    s, one, met = np.empty(7, np.complex128), np.empty(7, np.complex128), True
    slope[:] = 0.0
    for j in range(7 + len(shared)):
        k = j - 7
        if PHYSICS_COUNT <= k < PHYSICS_COUNT + NOSE_COUNT and k != PHYSICS_COUNT + side:
            continue
        begin, numbers, p = start.astype(np.complex128), shared.astype(np.complex128), neutral.astype(np.complex128)
        if j < 7:
            begin[j] += 1j * _COMPLEX_STEP
        else:
            numbers[k] += 1j * _COMPLEX_STEP
        fill_parameters(p, numbers)
        convert_slip_to_spin(begin, radius, s)
        came = wall - numbers[PHYSICS_COUNT + side]
        met = advance_past_cushion(
            s,
            until,
            nx,
            ny,
            came,
            radius + 0j,
            mass + 0j,
            p,
            law,
            numbers[PHYSICS_COUNT + NOSE_COUNT :],
            size,
            rows,
            phases,
        )
        convert_spin_to_slip(s, radius, one)
        value[:] = one.real
        slope[:, j] = one.imag / _COMPLEX_STEP
    return met
