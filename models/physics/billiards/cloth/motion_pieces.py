"""Motion of one ball as a table of pieces that are polynomials in time, and what it is at any moment."""

from __future__ import annotations

from models.numerics.jit import compiled
from models.physics.billiards.parameters import SPIN_DECAY

SLIDE, ROLL, REST, GLIDE = range(4)
"""Phases; a ball glides where there is no sliding friction and it does not roll."""
PHASE_NAMES = ("slide", "roll", "rest", "roll")
"""As `models.core.trajectory.PHASES` has them."""
START, END, X, Y, WX, WY, WIDTH = 0, 1, 2, 8, 14, 19, 24
"""Columns of a piece: times since the state (s), then coefficients of powers of the time since the piece began."""
STRAIGHT_ROWS, CURVED_ROWS = 4, 400
"""Pieces that fit in a table, in closed form and integrated."""
FOREVER = 1e9
"""s, the end of rest."""
CLOCK = 6
"""Of the seven numbers that are moved along: x, y, vx, vy, wx, wy and the time (s)."""


@compiled
def straight(s, rate, length, phase, rows, phases, k):  # type: ignore[no-untyped-def]
    """Piece k: constant acceleration and change of spin, rate (6,), for `length` (s); s (7,) is moved to its end."""
    row = rows[k]
    row[:] = 0.0
    row[START], row[END] = s[CLOCK], s[CLOCK] + length
    phases[k] = phase
    for i in range(2):
        row[X + 6 * i], row[X + 6 * i + 1], row[X + 6 * i + 2] = s[i], s[2 + i], 0.5 * rate[2 + i]
        row[WX + 5 * i], row[WX + 5 * i + 1] = s[4 + i], rate[4 + i]
    for i in range(2):
        s[i] = s[i] + (s[2 + i] + 0.5 * rate[2 + i] * length) * length
        s[2 + i] = s[2 + i] + rate[2 + i] * length
        s[4 + i] = s[4 + i] + rate[4 + i] * length
    s[CLOCK] = row[END]


@compiled
def piece_at(rows, count, tau):  # type: ignore[no-untyped-def]
    """Index of the piece at tau (s) since the state."""
    for k in range(count - 1):
        if tau.real < rows[k, END].real:
            return k
    return count - 1


@compiled
def side_spin(wz, rate, tau):  # type: ignore[no-untyped-def]
    """wz and its derivative after tau of a decay at `rate` (rad/s^2)."""
    sign = 1.0 if wz.real > 0.0 else -1.0
    if wz.real * sign <= rate.real * tau.real:
        return (0.0 * wz, 0.0 * wz) if rate.real > 0.0 else (wz - sign * rate * tau, 0.0 * wz)
    return wz - sign * rate * tau, 0.0 * wz - sign * rate


@compiled
def follow(rows, count, wz, p, tau, out, rate):  # type: ignore[no-untyped-def]
    """State out (7,) and its time derivative rate (7,) at tau (s) since the state with side spin wz."""
    row = rows[piece_at(rows, count, tau)]
    t = tau - row[START]
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
    out[6], rate[6] = side_spin(wz, p[SPIN_DECAY], tau)
