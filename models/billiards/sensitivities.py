"""Derivatives of a shot by its initial states, its physics and its noses, exact to rounding.

Between contacts they are carried by the derivative of one ball's motion, at a contact by that of the law; both are the
same compiled functions with a complex step. A contact is met earlier or later when the inputs change: with S the
derivative of the state at a fixed time, x' its rate and g the gap, the time of the contact moves by
dt = -(grad g . S) / (dg/dt), and past the contact S+ = C (S + x' dt) + C_p - x'+ dt, where C and C_p are the law's
derivatives (the saltation matrix: Aizerman and Gantmakher 1958, doi:10.1093/qjmam/11.3.338).
"""

from __future__ import annotations

import numpy as np

from models.billiards.cloth import WIDTH, follow, plan
from models.billiards.compiled import compiled
from models.billiards.contacts import meet_ball, meet_cushion
from models.billiards.engine import (
    BALL,
    FIRST,
    HOLE,
    KIND,
    LEG_BALL,
    LEG_STATE,
    LEG_TIME,
    LINE,
    SECOND,
    SOFT,
    TIME,
    normal,
)
from models.billiards.parameters import AIR_DRAG, NAMES, SLOPE_X, SLOPE_Y, VISCOUS_DRAG

BALL_COLUMNS = ("x", "y", "vx", "vy", "wx", "wy", "wz", "radius", "mass")
"""Columns of one ball; after those of all balls come the parameters, then the offsets of the noses."""
CURVING = (SLOPE_X, SLOPE_Y, AIR_DRAG, VISCOUS_DRAG)
"""Parameters whose derivatives have no closed form, even where they are 0."""
PER_BALL = len(BALL_COLUMNS)
_RADIUS, _MASS, _PARAMETERS = 7, 8, len(NAMES)
_STEP = 1e-30
"""Of the complex step."""


@compiled
def derive_motion(state, radius, p, active, taus, rows, phases, out):  # type: ignore[no-untyped-def]
    """Fill out (T, 7, 8 + A): states at taus (T,) by the state, the radius and the `active` parameters."""
    found, rate = np.zeros(7, np.complex128), np.zeros(7, np.complex128)
    for j in range(8 + len(active)):
        s, r, q = state.astype(np.complex128), radius + 0j, p.astype(np.complex128)
        if j < 7:
            s[j] += 1j * _STEP
        elif j == 7:
            r += 1j * _STEP
        else:
            q[active[j - 8]] += 1j * _STEP
        count = plan(s, r, q, taus[-1] + 1.0, rows, phases)
        for i in range(len(taus)):
            if taus[i] == 0.0:
                out[i, :, j] = s.imag / _STEP
                continue
            follow(rows, count, s[6], q, taus[i] + 0j, found, rate)
            out[i, :, j] = found.imag / _STEP


@compiled
def carry(motion, sensitivity, ball, n, active):  # type: ignore[no-untyped-def]
    """Derivatives (7, P) after a motion (7, 8 + A) from those before it."""
    after = np.ascontiguousarray(motion[:, :7]) @ sensitivity
    after[:, PER_BALL * ball + _RADIUS] += motion[:, 7]
    for j in range(len(active)):
        after[:, PER_BALL * n + active[j]] += motion[:, 8 + j]
    return after


@compiled
def derive_cushion(s, kind, row, lines, arcs, normals, radius, mass, p, active, law, soft):  # type: ignore[no-untyped-def]
    """(7, 10 + A) derivatives of the state after a cushion by state, radius, mass, offset and parameters."""
    made = np.zeros((7, 10 + len(active)))
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    for j in range(10 + len(active)):
        z, r, m, q = s.astype(np.complex128), radius + 0j, mass + 0j, p.astype(np.complex128)
        around = arcs.astype(np.complex128)
        if j < 7:
            z[j] += 1j * _STEP
        elif j == 7:
            r += 1j * _STEP
        elif j == 8:
            m += 1j * _STEP
        elif j > 9:
            q[active[j - 10]] += 1j * _STEP
        elif kind != LINE:
            around[row, 0] += 1j * _STEP * normals[side, 0]
            around[row, 1] += 1j * _STEP * normals[side, 1]
        out = np.zeros(7, np.complex128)
        nx, ny = normal(kind, row, z, lines, around)
        meet_cushion(z, nx, ny, r, m, q, law, soft, out)
        made[:, j] = out.imag / _STEP
    return made


@compiled
def derive_ball(a, b, ra, rb, ma, mb, p, active, law, soft):  # type: ignore[no-untyped-def]
    """(14, 18 + A) derivatives of two states after they touched by both states, radii, masses and parameters."""
    made = np.zeros((14, 18 + len(active)))
    for j in range(18 + len(active)):
        z = np.zeros(18, np.complex128)
        z[:7], z[7:14], z[14], z[15], z[16], z[17] = a, b, ra, rb, ma, mb
        q, out = p.astype(np.complex128), np.zeros(14, np.complex128)
        if j < 18:
            z[j] += 1j * _STEP
        else:
            q[active[j - 18]] += 1j * _STEP
        meet_ball(z[:7], z[7:14], z[14], z[15], z[16], z[17], q, law, soft, out)
        made[:, j] = out.imag / _STEP
    return made


@compiled
def outer(rate, times):  # type: ignore[no-untyped-def]
    """(7, P) of a rate (7,) and shifts in time (P,)."""
    return rate.reshape(-1, 1) * times.reshape(1, -1)


@compiled
def through_cushion(sens, s, before, after, kind, row, lines, arcs, normals, radius, mass, p, active, law, soft, a, n):  # type: ignore[no-untyped-def]
    """Derivatives (7, P) of ball a past a cushion; `before`, `after` are its rates (7,) on both sides."""
    nx, ny = normal(kind, row, s, lines, arcs)
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    gap = -nx * sens[0] - ny * sens[1]
    gap[PER_BALL * a + _RADIUS] -= 1.0
    gap[PER_BALL * n + _PARAMETERS + side] += nx * normals[side, 0] + ny * normals[side, 1]
    shift = gap / (nx * before[0] + ny * before[1])
    law_by = derive_cushion(s, kind, row, lines, arcs, normals, radius, mass, p, active, law, soft)
    found = np.ascontiguousarray(law_by[:, :7]) @ (sens + outer(before, shift)) - outer(after, shift)
    found[:, PER_BALL * a + _RADIUS] += law_by[:, 7]
    found[:, PER_BALL * a + _MASS] += law_by[:, 8]
    found[:, PER_BALL * n + _PARAMETERS + side] += law_by[:, 9]
    for j in range(len(active)):
        found[:, PER_BALL * n + active[j]] += law_by[:, 10 + j]
    return found


@compiled
def through_ball(sa, sb, a, b, rates, ra, rb, ma, mb, p, active, law, soft, i, j, n):  # type: ignore[no-untyped-def]
    """Derivatives (14, P) of balls i, j past their contact in states a, b; rates (4, 7) are those of a, b before and
    after."""
    nx, ny = b[0] - a[0], b[1] - a[1]
    size = np.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    gap = nx * (sb[0] - sa[0]) + ny * (sb[1] - sa[1])
    gap[PER_BALL * i + _RADIUS] -= 1.0
    gap[PER_BALL * j + _RADIUS] -= 1.0
    shift = -gap / (nx * (rates[1, 0] - rates[0, 0]) + ny * (rates[1, 1] - rates[0, 1]))
    law_by = derive_ball(a, b, ra, rb, ma, mb, p, active, law, soft)
    both = np.zeros((14, sa.shape[1]))
    both[:7], both[7:] = sa + outer(rates[0], shift), sb + outer(rates[1], shift)
    found = np.ascontiguousarray(law_by[:, :14]) @ both
    found[:7] -= outer(rates[2], shift)
    found[7:] -= outer(rates[3], shift)
    found[:, PER_BALL * i + _RADIUS] += law_by[:, 14]
    found[:, PER_BALL * j + _RADIUS] += law_by[:, 15]
    found[:, PER_BALL * i + _MASS] += law_by[:, 16]
    found[:, PER_BALL * j + _MASS] += law_by[:, 17]
    for k in range(len(active)):
        found[:, PER_BALL * n + active[k]] += law_by[:, 18 + k]
    return found


@compiled
def rate_at(leg, radius, p, tau, rows, phases, state, rate):  # type: ignore[no-untyped-def]
    """Fill state (7,) and its rate (7,) at tau after the start of a leg."""
    count = plan(leg[LEG_STATE:], radius, p, tau + 1.0, rows, phases)
    follow(rows, count, leg[LEG_STATE + 6], p, tau, state, rate)


@compiled
def over_leg(legs, k, until, sens, radius, p, active, times, table_rows, out):  # type: ignore[no-untyped-def]
    """Fill out (T, N, 7, P) on leg k up to the time `until`; the derivatives (7, P) there."""
    ball, start = int(legs[k, LEG_BALL]), legs[k, LEG_TIME]
    n, first = out.shape[1], np.searchsorted(times, start) if start > 0.0 else 0
    after = max(first, len(times) if until == np.inf else np.searchsorted(times, until))
    taus = np.zeros(after - first + 1)
    taus[:-1] = times[first:after] - start
    taus[-1] = until - start if until < np.inf else (taus[-2] if len(taus) > 1 else 0.0)
    rows, phases = np.zeros((table_rows, WIDTH), np.complex128), np.zeros(table_rows, np.int64)
    motion = np.zeros((len(taus), 7, 8 + len(active)))
    derive_motion(legs[k, LEG_STATE:].copy(), radius[ball], p, active, taus, rows, phases, motion)
    for i in range(first, after):
        out[i, ball] = carry(motion[i - first], sens, ball, n, active)
    return carry(motion[-1], sens, ball, n, active)


@compiled
def differentiate(  # type: ignore[no-untyped-def]
    legs, contacts, gone, radius, mass, p, laws, lines, arcs, normals, seconds, times, active, table_rows, out
):
    """Fill out (T, N, 7, P) with the derivatives of the states at sorted times (T,)."""
    n, columns = len(radius), out.shape[3]
    rows, phases = np.zeros((table_rows, WIDTH)), np.zeros(table_rows, np.int64)
    sens, leg = np.zeros((n, 7, columns)), np.zeros(n, np.int64)
    for k in range(len(legs) - 1, -1, -1):
        leg[int(legs[k, LEG_BALL])] = k
    for a in range(n):
        for j in range(7):
            sens[a, j, PER_BALL * a + j] = 1.0
    states, rates = np.zeros((4, 7)), np.zeros((4, 7))
    for e in range(len(contacts)):
        t, a, b = contacts[e, TIME], int(contacts[e, FIRST]), int(contacts[e, SECOND])
        kind, soft = int(contacts[e, KIND]), contacts[e, SOFT] > 0.0
        met = np.array([a, b]) if kind == BALL else np.array([a])
        for m in range(len(met)):
            k = leg[met[m]]
            sens[met[m]] = over_leg(legs, k, t, sens[met[m]], radius, p, active, times, table_rows, out)
            rate_at(legs[k], radius[met[m]], p, t - legs[k, LEG_TIME], rows, phases, states[m], rates[m])
            leg[met[m]] = k + 1
            rate_at(legs[k + 1], radius[met[m]], p, 0.0, rows, phases, states[2 + m], rates[2 + m])
        if kind == BALL:
            both = through_ball(
                sens[a], sens[b], states[0], states[1], rates, radius[a], radius[b], mass[a], mass[b],
                p, active, laws[1], soft, a, b, n,
            )  # fmt: skip
            sens[a], sens[b] = both[:7], both[7:]
        elif kind != HOLE:
            sens[a] = through_cushion(
                sens[a], states[0], rates[0], rates[2], kind, b, lines, arcs, normals, radius[a], mass[a],
                p, active, laws[0], soft, a, n,
            )  # fmt: skip
    for a in range(n):
        if gone[a] == np.inf:
            over_leg(legs, leg[a], np.inf, sens[a], radius, p, active, times, table_rows, out)
