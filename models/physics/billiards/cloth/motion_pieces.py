"""Motion of one ball as a table of pieces that are polynomials in time, and its state at any moment."""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards.parameter_vector import SPIN_DECAY

# Phases; a ball glides where there is no sliding friction and it does not roll. For a Python integer as an argument,
# numba compiles a function of its own per value.
SLIDE, ROLL, REST, GLIDE = map(np.int64, range(4))
# Names of the phases in `models.core.trajectory.PHASES`.
PHASE_NAMES = ("slide", "roll", "rest", "roll")
# Columns of a piece: start and end (s since the state), then coefficients of powers of the time since the piece began:
# six each for x and y (m), five each for wx and wy (rad/s).
PIECE_START, PIECE_END, X, Y, WX, WY, PIECE_WIDTH = map(np.int64, (0, 1, 2, 8, 14, 19, 24))
# Number of pieces in a table, for motion in closed form and for integrated motion.
CLOSED_FORM_PIECES, INTEGRATED_PIECES = 4, 400
# s, duration of rest.
REST_DURATION = 1e9
# Index of the time (s) in the seven numbers that are moved along: x, y, vx, vy, wx, wy, time.
CLOCK = 6


@compile_kernel
def count_pieces(has_curves):  # type: ignore[no-untyped-def]
    """Return the number of pieces of a table, for paths in closed form or integrated ones."""
    return INTEGRATED_PIECES if has_curves else CLOSED_FORM_PIECES


@compile_kernel
def write_parabola(s, rate, length, phase, rows, phases, k):  # type: ignore[no-untyped-def]
    """Write piece k with constant acceleration and change of spin, and move s to its end.

    Args:
        s: (7,) x, y (m), vx, vy (m/s), wx, wy (rad/s), time (s); changed in place.
        rate: (6,) its time derivative.
        length: Duration, s.
        phase: Phase of the piece.
        rows: (K, PIECE_WIDTH) receives the piece.
        phases: (K,) receives its phase.
        k: Row.
    """
    row = rows[k]
    for i in range(PIECE_WIDTH):
        row[i] = 0.0
    row[PIECE_START], row[PIECE_END] = s[CLOCK], s[CLOCK] + length
    phases[k] = phase
    for i in range(2):
        row[X + 6 * i], row[X + 6 * i + 1], row[X + 6 * i + 2] = s[i], s[2 + i], 0.5 * rate[2 + i]
        row[WX + 5 * i], row[WX + 5 * i + 1] = s[4 + i], rate[4 + i]
    for i in range(2):
        s[i] = s[i] + (s[2 + i] + 0.5 * rate[2 + i] * length) * length
        s[2 + i] = s[2 + i] + rate[2 + i] * length
        s[4 + i] = s[4 + i] + rate[4 + i] * length
    s[CLOCK] = row[PIECE_END]


@compile_kernel
def find_piece(rows, count, tau):  # type: ignore[no-untyped-def]
    """Find the piece at a time.

    Args:
        rows: (K, PIECE_WIDTH) pieces.
        count: Number of pieces.
        tau: s since the state.

    Returns:
        The row of the piece.
    """
    for k in range(count - 1):
        if tau.real < rows[k, PIECE_END].real:
            return k
    return count - 1


@compile_kernel
def side_spin_at(wz, rate, tau):  # type: ignore[no-untyped-def]
    """Evaluate side spin that decays.

    Args:
        wz: Side spin at the start, rad/s.
        rate: Decay, rad/s^2.
        tau: s since the start.

    Returns:
        The side spin (rad/s) and its time derivative (rad/s^2).
    """
    sign = 1.0 if wz.real > 0.0 else -1.0
    if wz.real * sign <= rate.real * tau.real:
        return (0.0 * wz, 0.0 * wz) if rate.real > 0.0 else (wz - sign * rate * tau, 0.0 * wz)
    return wz - sign * rate * tau, 0.0 * wz - sign * rate


@compile_kernel
def evaluate_pieces(rows, count, wz, p, tau, out, rate):  # type: ignore[no-untyped-def]
    """Evaluate state and time derivative of planned motion.

    Args:
        rows: (K, PIECE_WIDTH) pieces.
        count: Number of pieces.
        wz: Side spin at the start, rad/s.
        p: (P,) physical parameters.
        tau: s since the start.
        out: (7,) receives the state.
        rate: (7,) receives its time derivative.
    """
    row = rows[find_piece(rows, count, tau)]
    t = tau - row[PIECE_START]
    for i in range(2):
        x, v, a = 0.0 * t, 0.0 * t, 0.0 * t
        for j in range(5, -1, -1):
            a = a * t + v
            v = v * t + x
            x = x * t + row[X + 6 * i + j]
        w, turn = 0.0 * t, 0.0 * t
        for j in range(4, -1, -1):
            turn = turn * t + w
            w = w * t + row[WX + 5 * i + j]
        out[i], out[2 + i], out[4 + i] = x, v, w
        rate[i], rate[2 + i], rate[4 + i] = v, 2.0 * a, turn
    out[6], rate[6] = side_spin_at(wz, p[SPIN_DECAY], tau)
