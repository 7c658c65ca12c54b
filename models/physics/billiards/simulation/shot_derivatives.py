"""Derivatives of a shot along directions in all that it depends on: exact to rounding, to 1e-6 where paths are bent.

What a shot depends on are the states, radii and masses of its balls, its physics and its noses. A direction moves any
of them together: one ball, one parameter, or the radii of all balls at once. Only as many columns are carried as there
are directions.

Between contacts they are carried by the derivative of one ball's motion, at a contact by that of the law; both are the
same compiled functions with a complex step. A contact is met earlier or later when the inputs change: with S the
derivative of the state at a fixed time, x' its rate and g the gap, the time of the contact moves by
dt = -(grad g . S) / (dg/dt), and past the contact S+ = C (S + x' dt) + C_p - x'+ dt, where C and C_p are the law's
derivatives (the saltation matrix: Aizerman and Gantmakher 1958, doi:10.1093/qjmam/11.3.338).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import STEP, compiled
from models.physics.billiards.cloth.cloth_motion import plan
from models.physics.billiards.cloth.motion_derivatives import AHEAD, derive_motion
from models.physics.billiards.cloth.motion_pieces import WIDTH, follow
from models.physics.billiards.parameters import (
    AIR_DRAG,
    BALL_E,
    BALL_MU,
    CUSHION_E,
    CUSHION_E_POWER,
    CUSHION_LAWS,
    CUSHION_MU,
    NAMES,
    PRESSED_CLOTH,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    VISCOUS_DRAG,
)
from models.physics.billiards.simulation.contact_resolution import meet_ball, meet_cushion
from models.physics.billiards.simulation.event_engine import (
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

BALL_COLUMNS = ("x", "y", "vx", "vy", "wx", "wy", "wz", "radius", "mass")
"""What a shot depends on, ball by ball; after those of all balls come the parameters, then the offsets of the noses."""
CURVING = (SLOPE_X, SLOPE_Y, AIR_DRAG, VISCOUS_DRAG)
"""Parameters whose derivatives have no closed form, even where they are 0."""
PER_BALL = len(BALL_COLUMNS)
_RADIUS, _MASS, _PARAMETERS = 7, 8, len(NAMES)
_MATHAVAN = CUSHION_LAWS.index("mathavan_2010")


@compiled
def moved_by(sensitivity, directions, ball, n, active):  # type: ignore[no-untyped-def]
    """(8 + A, C): state, radius and `active` parameters of a ball along all directions."""
    found = np.empty((8 + len(active), sensitivity.shape[1]))
    found[:7] = sensitivity
    found[7] = directions[PER_BALL * ball + _RADIUS]
    for j in range(len(active)):
        found[8 + j] = directions[PER_BALL * n + active[j]]
    return found


@compiled
def derive_cushion(s, kind, row, lines, arcs, normals, radius, mass, weighed, p, active, law, soft):  # type: ignore[no-untyped-def]
    """(7, 10 + A) derivatives of the state after a cushion by state, radius, mass where it is `weighed`, offset and
    parameters."""
    made = np.zeros((7, 10 + len(active)))
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    for j in range(10 + len(active)):
        if (j > 9 and not felt_by_cushion(active[j - 10], law)) or (j == 8 and not weighed):
            continue
        if kind == LINE and (j < 2 or j == 9):  # a straight nose is the same everywhere
            if j < 2:
                made[j, j] = 1.0
            continue
        z, r, m, q = s.astype(np.complex128), radius + 0j, mass + 0j, p.astype(np.complex128)
        around = arcs.astype(np.complex128)
        if j < 7:
            z[j] += 1j * STEP
        elif j == 7:
            r += 1j * STEP
        elif j == 8:
            m += 1j * STEP
        elif j > 9:
            q[active[j - 10]] += 1j * STEP
        else:
            around[row, 0] += 1j * STEP * normals[side, 0]
            around[row, 1] += 1j * STEP * normals[side, 1]
        out = np.zeros(7, np.complex128)
        nx, ny = normal(kind, row, z, lines, around)
        meet_cushion(z, nx, ny, r, m, q, law, soft, out)
        made[:, j] = out.imag / STEP
    return made


@compiled
def felt_by_cushion(parameter, law):  # type: ignore[no-untyped-def]
    """Whether a cushion law looks at a parameter."""
    if parameter in (SLIDING_MU, PRESSED_CLOTH):
        return law == _MATHAVAN
    return CUSHION_E <= parameter <= CUSHION_MU or parameter == CUSHION_E_POWER


@compiled
def derive_ball(a, b, ra, rb, ma, mb, p, active, law, soft):  # type: ignore[no-untyped-def]
    """(14, 18 + A) derivatives of two states after they touched by both states, radii, masses and parameters."""
    made = np.zeros((14, 18 + len(active)))
    for j in range(18 + len(active)):
        if j >= 18 and not BALL_E <= active[j - 18] <= BALL_MU:
            continue
        z = np.zeros(18, np.complex128)
        z[:7], z[7:14], z[14], z[15], z[16], z[17] = a, b, ra, rb, ma, mb
        q, out = p.astype(np.complex128), np.zeros(14, np.complex128)
        if j < 18:
            z[j] += 1j * STEP
        else:
            q[active[j - 18]] += 1j * STEP
        meet_ball(z[:7], z[7:14], z[14], z[15], z[16], z[17], q, law, soft, out)
        made[:, j] = out.imag / STEP
    return made


@compiled
def outer(rate, times):  # type: ignore[no-untyped-def]
    """(7, C) of a rate (7,) and shifts in time (C,)."""
    return rate.reshape(-1, 1) * times.reshape(1, -1)


@compiled
def through_cushion(  # type: ignore[no-untyped-def]
    sens, s, before, after, kind, row, lines, arcs, normals, radius, mass, p, active, law, soft, a, n, directions
):
    """Derivatives (7, C) of ball a past a cushion; `before`, `after` are its rates (7,) on both sides."""
    nx, ny = normal(kind, row, s, lines, arcs)
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    nose = directions[PER_BALL * n + _PARAMETERS + side]
    gap = -nx * sens[0] - ny * sens[1] - directions[PER_BALL * a + _RADIUS]
    gap += nose * (nx * normals[side, 0] + ny * normals[side, 1])
    shift = gap / (nx * before[0] + ny * before[1])
    weighed = np.any(directions[PER_BALL * a + _MASS] != 0.0)
    law_by = derive_cushion(s, kind, row, lines, arcs, normals, radius, mass, weighed, p, active, law, soft)
    told = np.empty((10 + len(active), sens.shape[1]))
    told[:7] = sens + outer(before, shift)
    told[7], told[8], told[9] = directions[PER_BALL * a + _RADIUS], directions[PER_BALL * a + _MASS], nose
    for j in range(len(active)):
        told[10 + j] = directions[PER_BALL * n + active[j]]
    return law_by @ told - outer(after, shift)


@compiled
def through_ball(sa, sb, a, b, rates, ra, rb, ma, mb, p, active, law, soft, i, j, n, directions):  # type: ignore[no-untyped-def]
    """Derivatives (14, C) of balls i, j past their contact in states a, b; rates (4, 7) are those of a, b before and
    after."""
    nx, ny = b[0] - a[0], b[1] - a[1]
    size = np.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    gap = nx * (sb[0] - sa[0]) + ny * (sb[1] - sa[1])
    gap -= directions[PER_BALL * i + _RADIUS] + directions[PER_BALL * j + _RADIUS]
    shift = -gap / (nx * (rates[1, 0] - rates[0, 0]) + ny * (rates[1, 1] - rates[0, 1]))
    law_by = derive_ball(a, b, ra, rb, ma, mb, p, active, law, soft)
    told = np.empty((18 + len(active), sa.shape[1]))
    told[:7], told[7:14] = sa + outer(rates[0], shift), sb + outer(rates[1], shift)
    told[14], told[15] = directions[PER_BALL * i + _RADIUS], directions[PER_BALL * j + _RADIUS]
    told[16], told[17] = directions[PER_BALL * i + _MASS], directions[PER_BALL * j + _MASS]
    for k in range(len(active)):
        told[18 + k] = directions[PER_BALL * n + active[k]]
    found = law_by @ told
    found[:7] -= outer(rates[2], shift)
    found[7:] -= outer(rates[3], shift)
    return found


@compiled
def over_leg(  # type: ignore[no-untyped-def]
    legs, k, until, end, sens, radius, p, active, times, place, directions, rows, phases, shown, out, at_end
):
    """Fill out (K, R, C) on leg k up to the time `until`, and where `end` lies on it at_end (N, 7, C); the derivatives
    (7, C) at `until`."""
    ball, start = int(legs[k, LEG_BALL]), legs[k, LEG_TIME]
    first = np.searchsorted(times, start) if start > 0.0 else 0
    after = max(first, len(times) if until == np.inf else np.searchsorted(times, until))
    seen = first + np.flatnonzero(place[first:after, ball] >= 0)
    told = moved_by(sens, directions, ball, place.shape[1], active)
    kept, columns = out.shape[1], len(told)
    needed = np.array([np.any(told[j] != 0.0) for j in range(columns)])
    parts, last = shown[: len(seen) * kept * columns].reshape(len(seen), kept, columns), np.empty((7, columns))
    stop, stopped = (end - start if start <= end < until else np.inf), np.empty((7, columns))
    derive_motion(
        legs[k, LEG_STATE:].copy(), radius[ball], p, active, needed, times[seen] - start, until - start, stop, rows,
        phases, parts, last, stopped,
    )  # fmt: skip
    if stop < np.inf:
        at_end[ball] = stopped @ told
    made = parts.reshape(-1, columns) @ told
    for i in range(len(seen)):
        out[place[seen[i], ball]] = made[i * kept : (i + 1) * kept]
    return last @ told


@compiled
def rate_at(leg, until, radius, p, rows, phases, state, rate):  # type: ignore[no-untyped-def]
    """Fill state (7,) and its change rate (7,) of a leg at the time `until`."""
    count = plan(leg[LEG_STATE:], radius, p, until - leg[LEG_TIME] + AHEAD, rows, phases)
    follow(rows, count, leg[LEG_STATE + 6], p, until - leg[LEG_TIME], state, rate)


@compiled
def differentiate(  # type: ignore[no-untyped-def]
    legs, contacts, gone, radius, mass, p, laws, lines, arcs, normals, times, place, end, directions, active,
    table_rows, out, at_end,
):  # fmt: skip
    """Fill out (K, R, C) with derivatives of the first R of the seven numbers of a ball, 2 or 7, along `directions`,
    and at_end (N, 7, C) with those of all balls at the time `end`, where that is finite.

    times (T,) are sorted; place (T, N) says which of the K each is, -1 where it is not asked for. directions
    (9 N + P + 4, C); `active` are the parameters that one of them moves.
    """
    n, columns = len(radius), directions.shape[1]
    rows, phases = np.zeros((table_rows, WIDTH)), np.zeros(table_rows, np.int64)
    complex_rows = np.zeros((table_rows, WIDTH), np.complex128)
    shown = np.empty(len(times) * out.shape[1] * (8 + len(active)))
    sens, leg = np.zeros((n, 7, columns)), np.zeros(n, np.int64)
    for k in range(len(legs) - 1, -1, -1):
        leg[int(legs[k, LEG_BALL])] = k
    for a in range(n):
        sens[a] = directions[PER_BALL * a : PER_BALL * a + 7]
    states, rates, unused = np.zeros((2, 7)), np.zeros((4, 7)), np.zeros(7)
    for e in range(len(contacts)):
        t, a, b = contacts[e, TIME], int(contacts[e, FIRST]), int(contacts[e, SECOND])
        kind, soft = int(contacts[e, KIND]), contacts[e, SOFT] > 0.0
        met = np.array([a, b]) if kind == BALL else np.array([a])
        for m in range(len(met)):
            k = leg[met[m]]
            sens[met[m]] = over_leg(
                legs, k, t, end, sens[met[m]], radius, p, active, times, place, directions, complex_rows, phases,
                shown, out, at_end,
            )  # fmt: skip
            leg[met[m]] = k + 1
            rate_at(legs[k], t, radius[met[m]], p, rows, phases, states[m], rates[m])
            rate_at(legs[k + 1], t, radius[met[m]], p, rows, phases, unused, rates[2 + m])
        if kind == BALL:
            both = through_ball(
                sens[a], sens[b], states[0], states[1], rates, radius[a], radius[b], mass[a], mass[b],
                p, active, laws[1], soft, a, b, n, directions,
            )  # fmt: skip
            sens[a], sens[b] = both[:7], both[7:]
        elif kind != HOLE:
            sens[a] = through_cushion(
                sens[a], states[0], rates[0], rates[2], kind, b, lines, arcs, normals, radius[a], mass[a],
                p, active, laws[0], soft, a, n, directions,
            )  # fmt: skip
    for a in range(n):
        if gone[a] == np.inf:
            over_leg(
                legs, leg[a], np.inf, end, sens[a], radius, p, active, times, place, directions, complex_rows, phases,
                shown, out, at_end,
            )  # fmt: skip
