"""Any number of balls from contact to contact: the earliest is found exactly, resolved, and what it changed is redone.

No time step: a contact is the first root of a polynomial (roots.py), so no ball tunnels through another at any speed.
Contacts at the same time are resolved one after the other, the fastest first, until none closes; those that close more
slowly than `GENTLE` wait until the balls have sunk in by a micrometre and are then elastic, which ends every sequence
of ever smaller bounces. Energy never grows.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.numerics.roots import MOST_DEGREE, NEVER, meeting
from models.physics.billiards.cloth.cloth_motion import plan
from models.physics.billiards.cloth.motion_pieces import END, REST, START, WIDTH, X, Y, follow, piece_at
from models.physics.billiards.simulation.contact_resolution import meet_ball, meet_cushion

BALL, LINE, ARC, HOLE = range(4)
"""What a ball meets."""
KIND, TIME, FIRST, SECOND, SPEED, SOFT, EVENT_WIDTH = 0, 1, 2, 3, 4, 5, 6
"""Columns of a logged event; `SECOND` is a ball or a row of lines, arcs or holes, `SOFT` is 1 for gentle contacts."""
LEG_BALL, LEG_TIME, LEG_STATE, LEG_WIDTH = 0, 1, 2, 9
"""Columns of a leg, the motion of one ball between two contacts: it starts in this state."""
AT_ONCE = 1e-12
"""s: contacts that are nearer in time than this are taken to be at the same time."""
_CROSSINGS = 20
"""Of the line of a nose beyond its ends, on one piece of a path."""


@compiled
def shift(row, at, tau, out):  # type: ignore[no-untyped-def]
    """Coefficients out (6,) of the polynomial row[at:at + 6] in the time since tau."""
    out[:] = row[at : at + 6]
    for i in range(5):
        for j in range(4, i - 1, -1):
            out[j] += tau * out[j + 1]


@compiled
def spread(x, y, length):  # type: ignore[no-untyped-def]
    """Bound (m) on how far (x, y), coefficients (6,) each, goes within `length`."""
    total = 0.0
    for k in range(5, 0, -1):
        total = total * length + np.sqrt(x[k] * x[k] + y[k] * y[k])
    return total * length


@compiled
def squared(x, y, reach, c):  # type: ignore[no-untyped-def]
    """Fill c (11,) with the coefficients of x^2 + y^2 - reach^2; x, y (6,)."""
    c[:] = 0.0
    for i in range(6):
        for j in range(6):
            c[i + j] += x[i] * x[j] + y[i] * y[j]
    c[0] -= reach * reach


@compiled
def when_centres(x, y, reach, length, work):  # type: ignore[no-untyped-def]
    """Meeting of two centres x, y (6,) apart at the distance `reach`, within `length`."""
    clear = reach + spread(x, y, length)
    if x[0] * x[0] + y[0] * y[0] > clear * clear:
        return NEVER, 0.0, False
    c = work[3]
    squared(x, y, reach, c)
    return meeting(c, MOST_DEGREE, length, reach, 0.0, False, work)


@compiled
def when_balls(a, b, now, until, radius, t0, rows, phases, counts, work):  # type: ignore[no-untyped-def]
    """When balls a and b next touch, between the absolute times now and until (s)."""
    i, j = piece_at(rows[a], counts[a], now - t0[a]), piece_at(rows[b], counts[b], now - t0[b])
    x, y, other = work[4], work[5], work[6]
    while now < until and not (phases[a, i] == REST and phases[b, j] == REST):
        end = min(t0[a] + rows[a, i, END], t0[b] + rows[b, j, END], until)
        if end > now:
            shift(rows[a, i], X, now - t0[a] - rows[a, i, START], x[:6])
            shift(rows[b, j], X, now - t0[b] - rows[b, j, START], other[:6])
            x[:6] -= other[:6]
            shift(rows[a, i], Y, now - t0[a] - rows[a, i, START], y[:6])
            shift(rows[b, j], Y, now - t0[b] - rows[b, j, START], other[:6])
            y[:6] -= other[:6]
            t, closing, soft = when_centres(x, y, radius[a] + radius[b], end - now, work)
            if t < NEVER:
                return now + t, closing, soft
        if i < counts[a] - 1 and t0[a] + rows[a, i, END] <= end:
            i += 1
        if j < counts[b] - 1 and t0[b] + rows[b, j, END] <= end:
            j += 1
        now = max(now, end)
    return NEVER, 0.0, False


@compiled
def when_line(x, y, line, radius, length, work):  # type: ignore[no-untyped-def]
    """Meeting of a ball at x, y (6,) with a straight nose: line is nx, ny, c, low, high, side."""
    nx, ny = line[0], line[1]
    gap = line[2] - radius - nx * x[0] - ny * y[0]
    if gap > spread(x, y, length):
        return NEVER, 0.0, False
    c = work[3]
    c[:] = 0.0
    for k in range(6):
        c[k] = -nx * x[k] - ny * y[k]
    c[0] = gap
    begin, through = 0.0, False
    for _ in range(_CROSSINGS):
        t, closing, soft = meeting(c, 5, length, 0.0, begin, through, work)
        if t == NEVER:
            return t, closing, soft
        along = 0.0
        for k in range(5, -1, -1):
            along = along * t + nx * y[k] - ny * x[k]
        if line[3] <= along <= line[4]:
            return t, closing, soft
        begin, through = t + AT_ONCE * 1e3, True
    return NEVER, 0.0, False


@compiled
def when_table(a, now, until, radius, t0, rows, phases, counts, lines, arcs, holes, work):  # type: ignore[no-untyped-def]
    """What of the table ball a next meets: time, closing speed, softness, kind and row."""
    i = piece_at(rows[a], counts[a], now - t0[a])
    x, y, other = work[4], work[5], work[6]
    best, speed, gentle, kind, row = NEVER, 0.0, False, LINE, 0
    while now < until and phases[a, i] != REST:
        end = min(t0[a] + rows[a, i, END], until)
        if end > now:
            shift(rows[a, i], X, now - t0[a] - rows[a, i, START], x[:6])
            shift(rows[a, i], Y, now - t0[a] - rows[a, i, START], y[:6])
            for k in range(len(lines) + len(arcs) + len(holes)):
                if k < len(lines):
                    what, m = LINE, k
                    t, closing, soft = when_line(x, y, lines[m], radius[a], min(end - now, best), work)
                else:
                    what, m = (
                        (ARC, k - len(lines)) if k < len(lines) + len(arcs) else (HOLE, k - len(lines) - len(arcs))
                    )
                    disc = arcs[m] if what == ARC else holes[m]
                    reach = disc[2] + radius[a] if what == ARC else disc[2]
                    other[:6] = x[:6]
                    other[0] -= disc[0]
                    work[7, :6] = y[:6]
                    work[7, 0] -= disc[1]
                    t, closing, soft = when_centres(other, work[7], reach, min(end - now, best), work)
                if t < best:
                    best, speed, gentle, kind, row = t, closing, soft, what, m
            if best < NEVER:
                return now + best, speed, gentle, kind, row
        if i < counts[a] - 1:
            i += 1
        now = max(now, end)
    return NEVER, 0.0, False, LINE, 0


@compiled
def normal(kind, row, s, lines, arcs):  # type: ignore[no-untyped-def]
    """Unit normal into the cushion where a ball at s meets it."""
    if kind == LINE:
        return lines[row, 0] + 0.0 * s[0], lines[row, 1] + 0.0 * s[0]
    nx, ny = arcs[row, 0] - s[0], arcs[row, 1] - s[1]
    size = np.sqrt(nx * nx + ny * ny)
    return nx / size, ny / size


@compiled
def earliest(ball_times, table_times):  # type: ignore[no-untyped-def]
    """The next contact: the earliest, of those at once the fastest; both times hold time and speed first."""
    n = len(table_times)
    first = NEVER
    for a in range(n):
        first = min(first, table_times[a, 0])
        for b in range(a):
            first = min(first, ball_times[a, b, 0])
    fastest, who, other = -1.0, -1, -1
    for a in range(n):
        if table_times[a, 0] <= first + AT_ONCE and table_times[a, 1] > fastest:
            fastest, who, other = table_times[a, 1], a, -1
        for b in range(a):
            if ball_times[a, b, 0] <= first + AT_ONCE and ball_times[a, b, 1] > fastest:
                fastest, who, other = ball_times[a, b, 1], a, b
    return first, who, other


@compiled
def play(start, radius, mass, p, laws, lines, arcs, holes, seconds, table_rows, events, legs):  # type: ignore[no-untyped-def]
    """Fill events (E, EVENT_WIDTH) and legs (L, LEG_WIDTH); how many of each, and whether there was room for all.

    start (N, 7); laws (cushion, ball); `table_rows` is the number of pieces that one leg may have.
    """
    n = len(start)
    state, t0, counts, here = start.copy(), np.zeros(n), np.zeros(n, np.int64), np.ones(n, np.bool_)
    rows, phases = np.zeros((n, table_rows, WIDTH)), np.zeros((n, table_rows), np.int64)
    ball_times, table_times = np.full((n, n, 3), NEVER), np.full((n, 5), NEVER)
    work, out, rate = np.zeros((8, 16)), np.zeros(14), np.zeros(7)
    changed, done, made = np.ones(n, np.bool_), 0, 0
    now = 0.0
    while True:
        for a in range(n):
            if not changed[a]:
                continue
            legs[made, LEG_BALL], legs[made, LEG_TIME], legs[made, LEG_STATE:] = a, now, state[a]
            made += 1
            t0[a] = now
            if here[a]:
                counts[a] = plan(state[a], radius[a], p, seconds - now, rows[a], phases[a])
        for a in range(n):
            if not changed[a]:
                continue
            table_times[a] = NEVER
            if here[a]:
                t, closing, soft, kind, row = when_table(
                    a, now, seconds, radius, t0, rows, phases, counts, lines, arcs, holes, work
                )
                table_times[a, 0], table_times[a, 1], table_times[a, 2] = t, closing, 1.0 if soft else 0.0
                table_times[a, 3], table_times[a, 4] = kind, row
            for b in range(n):
                if b == a or (changed[b] and b > a):
                    continue
                i, j = (a, b) if a > b else (b, a)
                ball_times[i, j] = NEVER
                if here[a] and here[b]:
                    t, closing, soft = when_balls(i, j, now, seconds, radius, t0, rows, phases, counts, work)
                    ball_times[i, j, 0], ball_times[i, j, 1], ball_times[i, j, 2] = t, closing, 1.0 if soft else 0.0
        changed[:] = False
        first, a, b = earliest(ball_times, table_times)
        if first > seconds:
            return done, made, True
        if done == len(events) or made + 2 > len(legs):
            return done, made, False
        now = max(now, first)
        follow(rows[a], counts[a], state[a, 6], p, now - t0[a], out[:7], rate)
        event = events[done]
        done += 1
        event[TIME], event[FIRST] = now, a
        changed[a] = True
        if b >= 0:
            follow(rows[b], counts[b], state[b, 6], p, now - t0[b], out[7:], rate)
            event[KIND], event[SECOND], event[SPEED], event[SOFT] = BALL, b, ball_times[a, b, 1], ball_times[a, b, 2]
            state[a], state[b] = out[:7], out[7:]
            if np.hypot(out[9], out[10]) > np.hypot(out[2], out[3]):
                a, b = b, a
                event[FIRST], event[SECOND] = a, b
            meet_ball(state[a], state[b], radius[a], radius[b], mass[a], mass[b], p, laws[1], event[SOFT] > 0, out)
            state[a], state[b] = out[:7], out[7:]
            changed[a] = changed[b] = True
            continue
        event[SPEED], event[SOFT], event[KIND], event[SECOND] = (
            table_times[a, 1], table_times[a, 2], table_times[a, 3], table_times[a, 4],
        )  # fmt: skip
        state[a] = out[:7]
        if event[KIND] == HOLE:
            here[a] = False
            continue
        nx, ny = normal(int(event[KIND]), int(event[SECOND]), state[a], lines, arcs)
        meet_cushion(state[a], nx, ny, radius[a], mass[a], p, laws[0], event[SOFT] > 0, out[:7])
        state[a] = out[:7]
