"""Derivatives of one ball's motion on the cloth by its state, its radius and the parameters.

Each column is one complex step.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import COMPLEX_STEP, compile_kernel
from models.physics.billiards.cloth.cloth_motion import plan_motion
from models.physics.billiards.cloth.motion_pieces import PIECE_START, REST, X, evaluate_pieces, find_piece, side_spin_at
from models.physics.billiards.parameter_vector import IS_CLOTH_PARAMETER, SPIN_DECAY

_SIDE_SPIN = 6
PLANNING_MARGIN = 1e-9
"""s by which a segment is planned beyond the last time that is wanted."""


@compile_kernel
def differentiate_motion(  # type: ignore[no-untyped-def]
    state, radius, p, bends, active, needed, taus, until, stop, rows, phases, at_times, last, stopped
):
    """Differentiate one ball's motion by its state, its radius and the active parameters.

    Args:
        state: (7,) at the initial state of the segment.
        radius: m.
        p: (P,) physical parameters.
        bends: As in `plan_motion`.
        active: (A,) indices of parameters.
        needed: (8 + A,) columns that are wanted; the others are 0.
        taus: (T,) s since the start, sorted.
        until: s; infinite if the state at the end of the segment is not wanted.
        stop: s; a further time, infinite if none is wanted.
        rows: (K, PIECE_WIDTH) complex workspace.
        phases: (K,) workspace.
        at_times: (T, R, 8 + A) receives the derivatives of the first R numbers of the state at taus.
        last: (7, 8 + A) receives those of the state at `until`.
        stopped: (7, 8 + A) receives those of the state at `stop`.
    """
    horizon = until
    if until == np.inf:
        horizon = max(taus[-1] if len(taus) > 0 else 0.0, stop if stop < np.inf else 0.0)
    at_times[:], last[:], stopped[:] = 0.0, 0.0, 0.0
    for j in range(8 + len(active)):
        if not needed[j] or (j >= 8 and not IS_CLOTH_PARAMETER[active[j - 8]]):
            continue
        if j < 2:  # the cloth is the same everywhere
            at_times[:, j, j], last[j, j], stopped[j, j] = 1.0, 1.0, 1.0
            continue
        s, r, q = state.astype(np.complex128), radius + 0j, p.astype(np.complex128)
        if j < 7:
            s[j] += 1j * COMPLEX_STEP
        elif j == 7:
            r += 1j * COMPLEX_STEP
        else:
            q[active[j - 8]] += 1j * COMPLEX_STEP
        if j == _SIDE_SPIN or (j >= 8 and active[j - 8] == SPIN_DECAY):  # side spin does not act on the path
            if at_times.shape[1] > _SIDE_SPIN:
                for i in range(len(taus)):
                    at_times[i, _SIDE_SPIN, j] = side_spin_at(s[6], q[SPIN_DECAY], taus[i] + 0j)[0].imag / COMPLEX_STEP
            if until < np.inf:
                last[_SIDE_SPIN, j] = side_spin_at(s[6], q[SPIN_DECAY], until + 0j)[0].imag / COMPLEX_STEP
            if stop < np.inf:
                stopped[_SIDE_SPIN, j] = side_spin_at(s[6], q[SPIN_DECAY], stop + 0j)[0].imag / COMPLEX_STEP
            continue
        count = plan_motion(s, r, q, bends, horizon + PLANNING_MARGIN, rows, phases)
        if at_times.shape[1] == 2:
            fill_place_derivatives(s, rows, phases, count, taus, at_times, j)
        else:
            for i in range(len(taus)):
                fill_state_derivatives(s, q, rows, count, taus[i], at_times[i], j)
        if until < np.inf:
            fill_state_derivatives(s, q, rows, count, until, last, j)
        if stop < np.inf:
            fill_state_derivatives(s, q, rows, count, stop, stopped, j)


@compile_kernel
def fill_place_derivatives(s, rows, phases, count, taus, at_times, j):  # type: ignore[no-untyped-def]
    """Write column j of at_times (T, 2, ...) from planned pieces whose numbers carry a step; taus (T,) in s."""
    for i in range(len(taus)):
        k = find_piece(rows, count, taus[i] + 0j)
        if taus[i] == 0.0:
            at_times[i, 0, j], at_times[i, 1, j] = s[0].imag / COMPLEX_STEP, s[1].imag / COMPLEX_STEP
            continue
        if i > 0 and phases[k] == REST and taus[i - 1] >= rows[k, PIECE_START].real:  # it lies where it lay
            at_times[i, 0, j], at_times[i, 1, j] = at_times[i - 1, 0, j], at_times[i - 1, 1, j]
            continue
        t = taus[i] - rows[k, PIECE_START]
        for axis in range(2):
            x = 0.0 * t
            for power in range(5, -1, -1):
                x = x * t + rows[k, X + 6 * axis + power]
            at_times[i, axis, j] = x.imag / COMPLEX_STEP


@compile_kernel
def fill_state_derivatives(s, q, rows, count, tau, out, j):  # type: ignore[no-untyped-def]
    """Write column j of out (7, ...) at tau (s) from planned pieces whose numbers carry a step."""
    if tau == 0.0:
        for i in range(7):
            out[i, j] = s[i].imag / COMPLEX_STEP
        return
    state, turn = np.zeros(7, np.complex128), np.zeros(7, np.complex128)
    evaluate_pieces(rows, count, s[6], q, tau + 0j, state, turn)
    for i in range(7):
        out[i, j] = state[i].imag / COMPLEX_STEP
