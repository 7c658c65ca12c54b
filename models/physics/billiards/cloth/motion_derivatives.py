"""Derivatives of one ball's motion on the cloth, by its state, its radius and the parameters: a complex step each."""

from __future__ import annotations

import numpy as np

from models.numerics.jit import STEP, compiled
from models.physics.billiards.cloth.cloth_motion import plan
from models.physics.billiards.cloth.motion_pieces import REST, START, X, follow, piece_at, side_spin
from models.physics.billiards.parameters import CUSHION_E, NAP, SPIN_DECAY

_SIDE_SPIN = 6
AHEAD = 1e-9
"""s beyond what is asked for: up to there a leg is planned."""


@compiled
def derive_motion(state, radius, p, active, needed, taus, until, stop, rows, phases, shown, last, stopped):  # type: ignore[no-untyped-def]
    """Derivatives of one ball's motion by its state, its radius and the `active` parameters.

    Fills shown (T, R, 8 + A) with those of the first R of its numbers at taus (T,), and, where `until` and `stop` are
    finite, last and stopped (7, 8 + A) with those of the state there. Columns that are not `needed` (8 + A,) are 0.
    """
    horizon = until
    if until == np.inf:
        horizon = max(taus[-1] if len(taus) > 0 else 0.0, stop if stop < np.inf else 0.0)
    shown[:], last[:], stopped[:] = 0.0, 0.0, 0.0
    for j in range(8 + len(active)):
        if not needed[j] or (j >= 8 and not felt_by_cloth(active[j - 8])):
            continue
        if j < 2:  # the cloth is the same everywhere
            shown[:, j, j], last[j, j], stopped[j, j] = 1.0, 1.0, 1.0
            continue
        s, r, q = state.astype(np.complex128), radius + 0j, p.astype(np.complex128)
        if j < 7:
            s[j] += 1j * STEP
        elif j == 7:
            r += 1j * STEP
        else:
            q[active[j - 8]] += 1j * STEP
        if j == _SIDE_SPIN or (j >= 8 and active[j - 8] == SPIN_DECAY):  # side spin does not act on the path
            if shown.shape[1] > _SIDE_SPIN:
                for i in range(len(taus)):
                    shown[i, _SIDE_SPIN, j] = side_spin(s[6], q[SPIN_DECAY], taus[i] + 0j)[0].imag / STEP
            if until < np.inf:
                last[_SIDE_SPIN, j] = side_spin(s[6], q[SPIN_DECAY], until + 0j)[0].imag / STEP
            if stop < np.inf:
                stopped[_SIDE_SPIN, j] = side_spin(s[6], q[SPIN_DECAY], stop + 0j)[0].imag / STEP
            continue
        count = plan(s, r, q, horizon + AHEAD, rows, phases)
        if shown.shape[1] == 2:
            derive_places(s, rows, phases, count, taus, shown, j)
        else:
            for i in range(len(taus)):
                derive_state(s, q, rows, count, taus[i], shown[i], j)
        if until < np.inf:
            derive_state(s, q, rows, count, until, last, j)
        if stop < np.inf:
            derive_state(s, q, rows, count, stop, stopped, j)


@compiled
def felt_by_cloth(parameter):  # type: ignore[no-untyped-def]
    """Whether a ball alone on the cloth feels a parameter."""
    return parameter < CUSHION_E or parameter == NAP


@compiled
def derive_places(s, rows, phases, count, taus, shown, j):  # type: ignore[no-untyped-def]
    """Column j of shown (T, 2, ...) from a plan whose numbers carry a step."""
    for i in range(len(taus)):
        k = piece_at(rows, count, taus[i] + 0j)
        if taus[i] == 0.0:
            shown[i, 0, j], shown[i, 1, j] = s[0].imag / STEP, s[1].imag / STEP
            continue
        if i > 0 and phases[k] == REST and taus[i - 1] >= rows[k, START].real:  # it lies where it lay
            shown[i, 0, j], shown[i, 1, j] = shown[i - 1, 0, j], shown[i - 1, 1, j]
            continue
        t = taus[i] - rows[k, START]
        for axis in range(2):
            x = 0.0 * t
            for power in range(5, -1, -1):
                x = x * t + rows[k, X + 6 * axis + power]
            shown[i, axis, j] = x.imag / STEP


@compiled
def derive_state(s, q, rows, count, tau, out, j):  # type: ignore[no-untyped-def]
    """Column j of out (7, ...) at tau (s) from a plan whose numbers carry a step."""
    if tau == 0.0:
        out[:, j] = s.imag / STEP
        return
    found, turn = np.zeros(7, np.complex128), np.zeros(7, np.complex128)
    follow(rows, count, s[6], q, tau + 0j, found, turn)
    out[:, j] = found.imag / STEP
