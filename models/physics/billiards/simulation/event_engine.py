"""Event-driven simulation of any number of balls: find the earliest contact exactly, resolve it, and repeat.

There is no time step: a contact is the first root of a polynomial (`models.numerics.roots`), so no ball tunnels through
another at any speed. Contacts at the same time are resolved one after the other, the fastest first, until none closes.
Contacts that close more slowly than `roots.GENTLE_SPEED` wait until the balls overlap by a micrometre and are then
elastic, which ends every sequence of ever smaller bounces. Energy never grows.

Arrays that the functions share: rows (N, K, PIECE_WIDTH) and phases (N, K) are the pieces of the current segment of
every ball, counts (N,) their number, start_times (N,) when the segments began (s); lines, arcs and holes are those of
`cushion_geometry.Rails`; `work` (8, 16) is workspace.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel, copy_numbers
from models.numerics.roots import MAX_DEGREE, NEVER, find_meeting
from models.physics.billiards.ball_cushion.rebound_correction import correct_rebound, rebound_energy
from models.physics.billiards.cloth.cloth_motion import plan_motion
from models.physics.billiards.cloth.forces import has_curved_path
from models.physics.billiards.cloth.motion_pieces import (
    PIECE_END,
    PIECE_START,
    PIECE_WIDTH,
    REST,
    X,
    Y,
    count_pieces,
    evaluate_pieces,
    find_piece,
)
from models.physics.billiards.simulation.contact_resolution import resolve_ball_contact, resolve_cushion_contact

# What a ball meets: another ball, a nose or facing, the arc of a jaw, a pocket.
BALL, LINE, ARC, HOLE = range(4)
# Columns of a logged event. `EVENT_SECOND` is a ball or a row of lines, arcs or holes; `EVENT_SPEED` is the closing
# speed (m/s); `EVENT_GENTLE` is 1 for gentle contacts.
EVENT_KIND, EVENT_TIME, EVENT_FIRST, EVENT_SECOND, EVENT_SPEED, EVENT_GENTLE, EVENT_WIDTH = 0, 1, 2, 3, 4, 5, 6
# Columns of a segment, the motion of one ball between two contacts: the ball, the time when the segment begins (s), and
# the seven numbers of the state there.
SEGMENT_BALL, SEGMENT_TIME, SEGMENT_STATE, SEGMENT_WIDTH = 0, 1, 2, 9
# s; contacts that are closer in time count as simultaneous.
SIMULTANEITY = 1e-12
# Degree of x and y of a piece of a path, and of the squared distance between two of them.
PATH_DEGREE, DISTANCE_DEGREE = np.int64(5), np.int64(MAX_DEGREE)
# Crossings of the line of a nose beyond its ends that one piece of a path may have.
_MOST_CROSSINGS = 20


@compile_kernel
def shift_polynomial(row, at, tau, out):  # type: ignore[no-untyped-def]
    """Write to out (6,) the coefficients of the polynomial row[at:at + 6] in the time since tau (s)."""
    for k in range(6):
        out[k] = row[at + k]
    for i in range(5):
        for j in range(4, i - 1, -1):
            out[j] += tau * out[j + 1]


@compile_kernel
def displacement_bound(x, y, length):  # type: ignore[no-untyped-def]
    """Bound the distance (m) that a path with coefficients x, y (6,) covers within `length` (s)."""
    total = 0.0
    for k in range(5, 0, -1):
        total = total * length + np.sqrt(x[k] * x[k] + y[k] * y[k])
    return total * length


@compile_kernel
def fill_squared_gap(x, y, reach, c):  # type: ignore[no-untyped-def]
    """Write to c (11,) the coefficients of x^2 + y^2 - reach^2, with x, y (6,) coefficients and reach in m."""
    c[:] = 0.0
    for i in range(6):
        for j in range(6):
            c[i + j] += x[i] * x[j] + y[i] * y[j]
    c[0] -= reach * reach


@compile_kernel
def find_centre_meeting(x, y, reach, length, work):  # type: ignore[no-untyped-def]
    """Find when the distance of two centres falls to `reach` (m) within `length` (s).

    x, y (6,) are the coefficients of the vector between the centres. Returns the time (s, `NEVER` if it does not), the
    closing speed (m/s) and whether the meeting is gentle.
    """
    clear = reach + displacement_bound(x, y, length)
    if x[0] * x[0] + y[0] * y[0] > clear * clear:
        return NEVER, 0.0, False
    c = work[3]
    fill_squared_gap(x, y, reach, c)
    return find_meeting(c, DISTANCE_DEGREE, length, reach, 0.0, np.bool_(False), work)


@compile_kernel
def find_ball_meeting(a, b, now, until, radius, start_times, rows, phases, counts, work):  # type: ignore[no-untyped-def]
    """Find when balls a and b touch next between the absolute times `now` and `until` (s).

    radius (N,) in m. Returns the absolute time (s, `NEVER` if they do not), the closing speed (m/s) and whether the
    contact is gentle.
    """
    i, j = find_piece(rows[a], counts[a], now - start_times[a]), find_piece(rows[b], counts[b], now - start_times[b])
    x, y, other = work[4], work[5], work[6]
    while now < until and not (phases[a, i] == REST and phases[b, j] == REST):
        end = min(start_times[a] + rows[a, i, PIECE_END], start_times[b] + rows[b, j, PIECE_END], until)
        if end > now:
            shift_polynomial(rows[a, i], X, now - start_times[a] - rows[a, i, PIECE_START], x[:6])
            shift_polynomial(rows[b, j], X, now - start_times[b] - rows[b, j, PIECE_START], other[:6])
            for k in range(6):
                x[k] -= other[k]
            shift_polynomial(rows[a, i], Y, now - start_times[a] - rows[a, i, PIECE_START], y[:6])
            shift_polynomial(rows[b, j], Y, now - start_times[b] - rows[b, j, PIECE_START], other[:6])
            for k in range(6):
                y[k] -= other[k]
            t, closing, soft = find_centre_meeting(x, y, radius[a] + radius[b], end - now, work)
            if t < NEVER:
                return now + t, closing, soft
        if i < counts[a] - 1 and start_times[a] + rows[a, i, PIECE_END] <= end:
            i += 1
        if j < counts[b] - 1 and start_times[b] + rows[b, j, PIECE_END] <= end:
            j += 1
        now = max(now, end)
    return NEVER, 0.0, False


@compile_kernel
def find_line_meeting(x, y, line, radius, length, work):  # type: ignore[no-untyped-def]
    """Find when a ball on the path x, y (6,) meets a straight nose within `length` (s).

    line (6,) is nx, ny, offset, low end, high end (m) and side; radius in m. Returns as `find_centre_meeting`.
    """
    nx, ny = line[0], line[1]
    gap = line[2] - radius - nx * x[0] - ny * y[0]
    if gap > displacement_bound(x, y, length):
        return NEVER, 0.0, False
    c = work[3]
    c[:] = 0.0
    for k in range(6):
        c[k] = -nx * x[k] - ny * y[k]
    c[0] = gap
    begin, through = 0.0, False
    for _ in range(_MOST_CROSSINGS):
        t, closing, soft = find_meeting(c, PATH_DEGREE, length, 0.0, begin, through, work)
        if t == NEVER:
            return t, closing, soft
        along = 0.0
        for k in range(5, -1, -1):
            along = along * t + nx * y[k] - ny * x[k]
        if line[3] <= along <= line[4]:
            return t, closing, soft
        begin, through = t + SIMULTANEITY * 1e3, True
    return NEVER, 0.0, False


@compile_kernel
def find_table_meeting(a, now, until, radius, start_times, rows, phases, counts, lines, arcs, holes, work):  # type: ignore[no-untyped-def]
    """Find what part of the table ball a meets next between the absolute times `now` and `until` (s).

    Returns the absolute time (s, `NEVER` if nothing), the closing speed (m/s), whether the contact is gentle, the kind
    (`LINE`, `ARC` or `HOLE`) and its row.
    """
    i = find_piece(rows[a], counts[a], now - start_times[a])
    x, y, other = work[4], work[5], work[6]
    best, speed, gentle, kind, row = NEVER, 0.0, False, LINE, 0
    while now < until and phases[a, i] != REST:
        end = min(start_times[a] + rows[a, i, PIECE_END], until)
        if end > now:
            shift_polynomial(rows[a, i], X, now - start_times[a] - rows[a, i, PIECE_START], x[:6])
            shift_polynomial(rows[a, i], Y, now - start_times[a] - rows[a, i, PIECE_START], y[:6])
            for k in range(len(lines) + len(arcs) + len(holes)):
                if k < len(lines):
                    obstacle, m = LINE, k
                    t, closing, soft = find_line_meeting(x, y, lines[m], radius[a], min(end - now, best), work)
                else:
                    obstacle, m = (
                        (ARC, k - len(lines)) if k < len(lines) + len(arcs) else (HOLE, k - len(lines) - len(arcs))
                    )
                    disc = arcs[m] if obstacle == ARC else holes[m]
                    reach = disc[2] + radius[a] if obstacle == ARC else disc[2]
                    copy_numbers(x[:6], other)
                    other[0] -= disc[0]
                    copy_numbers(y[:6], work[7])
                    work[7, 0] -= disc[1]
                    t, closing, soft = find_centre_meeting(other, work[7], reach, min(end - now, best), work)
                if t < best:
                    best, speed, gentle, kind, row = t, closing, soft, obstacle, m
            if best < NEVER:
                return now + best, speed, gentle, kind, row
        if i < counts[a] - 1:
            i += 1
        now = max(now, end)
    return NEVER, 0.0, False, LINE, 0


@compile_kernel
def cushion_normal(kind, row, s, lines, arcs):  # type: ignore[no-untyped-def]
    """Return the unit normal into a cushion where a ball meets it.

    Args:
        kind: `LINE` or `ARC`.
        row: Row of lines or arcs.
        s: (7,) state of the ball at the contact.
        lines: (L, 6) as in `cushion_geometry.Rails`.
        arcs: (A, 4) as in `cushion_geometry.Rails`.

    Returns:
        x and y of the normal.
    """
    if kind == LINE:
        return lines[row, 0] + 0.0 * s[0], lines[row, 1] + 0.0 * s[0]
    nx, ny = arcs[row, 0] - s[0], arcs[row, 1] - s[1]
    size = np.sqrt(nx * nx + ny * ny)
    return nx / size, ny / size


@compile_kernel
def disturb_rebound(s, nx, ny, radius, before, shares):  # type: ignore[no-untyped-def]
    """Add `shares` (5,) of the speed to the state s (7,) after a cushion contact, as `simulate_events` describes.

    The ball keeps leaving the cushion: its normal velocity does not change sign. A disturbance that would create energy
    is reduced until the ball leaves with as much as it came with: near grazing incidence, little can be lost.

    Args:
        s: State after the contact by the model; disturbed.
        nx: x of the normal into the cushion.
        ny: y of the normal.
        radius: m.
        before: (5,) state before the contact, as of `to_cushion_axes`.
        shares: Disturbance.
    """
    after = to_cushion_axes(s, nx, ny, radius)
    change = np.hypot(before[0], before[1]) * shares
    change[0] = min(change[0], -0.5 * after[0])
    excess = energy_of_axes(after) - energy_of_axes(before)
    both, own = energy_of_axes(after + change), energy_of_axes(change)
    share = 1.0
    if both > energy_of_axes(before):  # energy over the share: own share^2 + 2 half share + excess = 0
        half = 0.5 * (both - energy_of_axes(after) - own)
        share = max((np.sqrt(max(half * half - own * excess, 0.0)) - half) / max(own, 1e-30), 0.0)
    after += share * change
    from_cushion_axes(after, nx, ny, radius, s)


@compile_kernel
def energy_of_axes(axes):  # type: ignore[no-untyped-def]
    """Return twice the energy per mass (m^2/s^2) of what `to_cushion_axes` returns."""
    return rebound_energy(axes[0], axes[1], axes[2], axes[3], axes[4])


@compile_kernel
def to_cushion_axes(s, nx, ny, radius):  # type: ignore[no-untyped-def]
    """Return velocity along n and t, slip along n and t, and surface speed of side spin (5,) of a state s (7,)."""
    axes = np.empty(5)
    axes[0], axes[1] = nx * s[2] + ny * s[3], nx * s[3] - ny * s[2]
    wn, wt = nx * s[4] + ny * s[5], nx * s[5] - ny * s[4]
    axes[2], axes[3], axes[4] = axes[0] - radius * wt, axes[1] + radius * wn, radius * s[6]
    return axes


@compile_kernel
def from_cushion_axes(axes, nx, ny, radius, s):  # type: ignore[no-untyped-def]
    """Write velocity and spin of a state s (7,) from what `to_cushion_axes` returns."""
    vn, vt = axes[0], axes[1]
    wn, wt = (axes[3] - vt) / radius, (vn - axes[2]) / radius
    s[2], s[3], s[4], s[5] = nx * vn - ny * vt, ny * vn + nx * vt, nx * wn - ny * wt, ny * wn + nx * wt
    s[6] = axes[4] / radius


@compile_kernel
def select_earliest(ball_times, table_times):  # type: ignore[no-untyped-def]
    """Select the next contact: the earliest, and among simultaneous ones the fastest.

    ball_times (N, N, 3) and table_times (N, 5) begin with time (s) and closing speed (m/s). Returns the time, the first
    ball (-1 if there is no contact) and the other ball (-1 for a contact with the table).
    """
    n = len(table_times)
    first = NEVER
    for a in range(n):
        first = min(first, table_times[a, 0])
        for b in range(a):
            first = min(first, ball_times[a, b, 0])
    fastest, who, other = -1.0, -1, -1
    for a in range(n):
        if table_times[a, 0] <= first + SIMULTANEITY and table_times[a, 1] > fastest:
            fastest, who, other = table_times[a, 1], a, -1
        for b in range(a):
            if ball_times[a, b, 0] <= first + SIMULTANEITY and ball_times[a, b, 1] > fastest:
                fastest, who, other = ball_times[a, b, 1], a, b
    return first, who, other


@compile_kernel
def simulate_events(start, radius, mass, p, models, table, seconds, correction, errors, events, segments):  # type: ignore[no-untyped-def]
    """Simulate a shot and log its events and segments.

    Args:
        start: (N, 7) states at time 0: x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
        radius: (N,) m.
        mass: (N,) kg.
        p: (P,) physical parameters.
        models: Codes of the cushion model and of the ball model.
        table: Lines (L, 6), arcs (A, 4) and holes (H, 3) of `cushion_geometry.Rails`.
        seconds: Duration, s.
        correction: Weights of `rebound_correction` for contacts with cushions; empty for none.
        errors: (D, 5) added after the first D contacts with cushions that are not gentle, as shares of the speed
            before: to the velocity along n and t and to the slip along n and t, and to the surface speed of side spin;
            reduced where they would create energy.
        events: (E, EVENT_WIDTH) receives the events by time.
        segments: (L, SEGMENT_WIDTH) receives the segments by time.

    Returns:
        The number of events, the number of segments, and whether there was room for all.
    """
    n, (lines, arcs, holes), capacity = len(start), table, count_pieces(has_curved_path(p))
    state, start_times, counts, on_table = start.copy(), np.zeros(n), np.zeros(n, np.int64), np.ones(n, np.bool_)
    rows, phases = np.zeros((n, capacity, PIECE_WIDTH)), np.zeros((n, capacity), np.int64)
    ball_times, table_times = np.full((n, n, 3), NEVER), np.full((n, 5), NEVER)
    work, out, rate, before = np.zeros((8, 16)), np.zeros(14), np.zeros(7), np.zeros(5)
    changed, event_count, segment_count, bounces = np.ones(n, np.bool_), 0, 0, 0
    now = 0.0
    while True:
        for a in range(n):
            if not changed[a]:
                continue
            segments[segment_count, SEGMENT_BALL], segments[segment_count, SEGMENT_TIME] = a, now
            copy_numbers(state[a], segments[segment_count, SEGMENT_STATE:])
            segment_count += 1
            start_times[a] = now
            if on_table[a]:
                counts[a] = plan_motion(state[a], radius[a], p, seconds - now, rows[a], phases[a])
        for a in range(n):
            if not changed[a]:
                continue
            table_times[a] = NEVER
            if on_table[a]:
                t, closing, soft, kind, row = find_table_meeting(
                    a, now, seconds, radius, start_times, rows, phases, counts, lines, arcs, holes, work
                )
                table_times[a, 0], table_times[a, 1], table_times[a, 2] = t, closing, 1.0 if soft else 0.0
                table_times[a, 3], table_times[a, 4] = kind, row
            for b in range(n):
                if b == a or (changed[b] and b > a):
                    continue
                i, j = (a, b) if a > b else (b, a)
                ball_times[i, j] = NEVER
                if on_table[a] and on_table[b]:
                    t, closing, soft = find_ball_meeting(
                        i, j, now, seconds, radius, start_times, rows, phases, counts, work
                    )
                    ball_times[i, j, 0], ball_times[i, j, 1], ball_times[i, j, 2] = t, closing, 1.0 if soft else 0.0
        changed[:] = False
        first, a, b = select_earliest(ball_times, table_times)
        if first > seconds:
            return event_count, segment_count, True
        if event_count == len(events) or segment_count + 2 > len(segments):
            return event_count, segment_count, False
        now = max(now, first)
        evaluate_pieces(rows[a], counts[a], state[a, 6], p, now - start_times[a], out[:7], rate)
        event = events[event_count]
        event_count += 1
        event[EVENT_TIME], event[EVENT_FIRST] = now, a
        changed[a] = True
        if b >= 0:
            evaluate_pieces(rows[b], counts[b], state[b, 6], p, now - start_times[b], out[7:], rate)
            event[EVENT_KIND], event[EVENT_SECOND], event[EVENT_SPEED], event[EVENT_GENTLE] = (
                BALL,
                b,
                ball_times[a, b, 1],
                ball_times[a, b, 2],
            )
            copy_numbers(out[:7], state[a])
            copy_numbers(out[7:], state[b])
            if np.hypot(out[9], out[10]) > np.hypot(out[2], out[3]):
                a, b = b, a
                event[EVENT_FIRST], event[EVENT_SECOND] = a, b
            resolve_ball_contact(
                state[a], state[b], radius[a], radius[b], mass[a], mass[b], p, models[1], event[EVENT_GENTLE] > 0, out
            )
            copy_numbers(out[:7], state[a])
            copy_numbers(out[7:], state[b])
            changed[a] = changed[b] = True
            continue
        event[EVENT_SPEED], event[EVENT_GENTLE], event[EVENT_KIND], event[EVENT_SECOND] = (
            table_times[a, 1], table_times[a, 2], table_times[a, 3], table_times[a, 4],
        )  # fmt: skip
        copy_numbers(out[:7], state[a])
        if event[EVENT_KIND] == HOLE:
            on_table[a] = False
            continue
        nx, ny = cushion_normal(int(event[EVENT_KIND]), int(event[EVENT_SECOND]), state[a], lines, arcs)
        copy_numbers(to_cushion_axes(state[a], nx, ny, radius[a]), before)
        resolve_cushion_contact(state[a], nx, ny, radius[a], mass[a], p, models[0], event[EVENT_GENTLE] > 0, out[:7])
        if len(correction) > 0 and not event[EVENT_GENTLE] > 0:
            after = to_cushion_axes(out[:7], nx, ny, radius[a])
            correct_rebound(correction, before, after)
            from_cushion_axes(after, nx, ny, radius[a], out)
        if bounces < len(errors) and not event[EVENT_GENTLE] > 0:
            disturb_rebound(out, nx, ny, radius[a], before, errors[bounces])
            bounces += 1
        copy_numbers(out[:7], state[a])
