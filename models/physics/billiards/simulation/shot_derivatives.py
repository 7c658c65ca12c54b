"""Derivatives of a shot along directions in the space of its inputs: exact to rounding, to 1e-6 on integrated paths.

Inputs of a shot are the states, radii and masses of its balls, the physical parameters, and the offsets of the noses. A
direction changes any of them together: one ball, one parameter, or the radii of all balls at once. There are only as
many columns as directions.

Between contacts the derivatives follow from that of one ball's motion, at a contact from that of the contact model;
both are the same compiled functions with a complex step. A contact occurs earlier or later when the inputs change: with
S the derivative of the state at a fixed time, x' its rate and g the gap, the time of the contact changes by dt = -(grad
g . S) / (dg/dt), and after the contact S+ = C (S + x' dt) + C_p - x'+ dt, where C and C_p are the derivatives of the
contact model (the saltation matrix: Aizerman and Gantmakher 1958, doi:10.1093/qjmam/11.3.338).

Names that the functions share: directions (9 N + P + 4, C) over all inputs, `active` (A,) indices of the parameters
that a direction changes, `model` the code of a contact model, `gentle` whether a contact is gentle.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import COMPLEX_STEP, compile_kernel, copy_numbers, copy_rows
from models.physics.billiards.cloth.cloth_motion import plan_motion
from models.physics.billiards.cloth.forces import has_curved_path
from models.physics.billiards.cloth.motion_pieces import (
    PIECE_START,
    PIECE_WIDTH,
    REST,
    X,
    count_pieces,
    evaluate_pieces,
    find_piece,
    side_spin_at,
)
from models.physics.billiards.contact_models import BALL_MODEL_READS, CUSHION_MODEL_READS
from models.physics.billiards.parameter_vector import (
    IS_CLOTH_PARAMETER,
    PARAMETER_NAMES,
    PATH_BENDING_PARAMETERS,
    SPIN_DECAY,
)
from models.physics.billiards.simulation.contact_resolution import resolve_ball_contact, resolve_cushion_contact
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_GENTLE,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_TIME,
    HOLE,
    LINE,
    SEGMENT_BALL,
    SEGMENT_STATE,
    SEGMENT_TIME,
    cushion_normal,
)

# Inputs of a shot per ball; after those of all balls come the physical parameters, then the offsets of the noses.
BALL_COLUMNS = ("x", "y", "vx", "vy", "wx", "wy", "wz", "radius", "mass")
BALL_INPUTS = len(BALL_COLUMNS)
_RADIUS, _MASS, _PARAMETERS = 7, 8, len(PARAMETER_NAMES)


@compile_kernel
def stack_ball_inputs(sensitivity, directions, ball, n, active):  # type: ignore[no-untyped-def]
    """Stack state, radius and `active` parameters of a ball along all directions (8 + A, C)."""
    inputs = np.empty((8 + len(active), sensitivity.shape[1]))
    copy_rows(sensitivity, inputs)
    copy_numbers(directions[BALL_INPUTS * ball + _RADIUS], inputs[7])
    for j in range(len(active)):
        copy_numbers(directions[BALL_INPUTS * n + active[j]], inputs[8 + j])
    return inputs


@compile_kernel
def differentiate_cushion_contact(s, kind, row, lines, arcs, normals, radius, mass, by_mass, p, active, model, gentle):  # type: ignore[no-untyped-def]
    """Differentiate the state after a contact with a cushion (7, 10 + A).

    The columns are state, radius, mass (only if `by_mass`, else 0), nose offset and `active` parameters. s (7,) is the
    state before; normals (4, 2) point into the cushions; radius in m, mass in kg.
    """
    jacobian = np.zeros((7, 10 + len(active)))
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    for j in range(10 + len(active)):
        if (j > 9 and not CUSHION_MODEL_READS[model, active[j - 10]]) or (j == 8 and not by_mass):
            continue
        if kind == LINE and (j < 2 or j == 9):  # a straight nose is the same everywhere
            if j < 2:
                jacobian[j, j] = 1.0
            continue
        z, r, m, q = s.astype(np.complex128), radius + 0j, mass + 0j, p.astype(np.complex128)
        around = arcs.astype(np.complex128)
        if j < 7:
            z[j] += 1j * COMPLEX_STEP
        elif j == 7:
            r += 1j * COMPLEX_STEP
        elif j == 8:
            m += 1j * COMPLEX_STEP
        elif j > 9:
            q[active[j - 10]] += 1j * COMPLEX_STEP
        else:
            around[row, 0] += 1j * COMPLEX_STEP * normals[side, 0]
            around[row, 1] += 1j * COMPLEX_STEP * normals[side, 1]
        out = np.zeros(7, np.complex128)
        nx, ny = cushion_normal(kind, row, z, lines, around)
        resolve_cushion_contact(z, nx, ny, r, m, q, model, gentle, out)
        for i in range(len(out)):
            jacobian[i, j] = out[i].imag / COMPLEX_STEP
    return jacobian


@compile_kernel
def differentiate_ball_contact(a, b, ra, rb, ma, mb, p, active, model, gentle):  # type: ignore[no-untyped-def]
    """Differentiate the states of two balls after they touched (14, 18 + A).

    The columns are both states, radii, masses and `active` parameters. a, b (7,) are the states before; ra, rb in m;
    ma, mb in kg.
    """
    jacobian = np.zeros((14, 18 + len(active)))
    for j in range(18 + len(active)):
        if j >= 18 and not BALL_MODEL_READS[model, active[j - 18]]:
            continue
        z = np.zeros(18, np.complex128)
        copy_numbers(a, z)
        copy_numbers(b, z[7:])
        z[14], z[15], z[16], z[17] = ra, rb, ma, mb
        q, out = p.astype(np.complex128), np.zeros(14, np.complex128)
        if j < 18:
            z[j] += 1j * COMPLEX_STEP
        else:
            q[active[j - 18]] += 1j * COMPLEX_STEP
        resolve_ball_contact(z[:7], z[7:14], z[14], z[15], z[16], z[17], q, model, gentle, out)
        for i in range(len(out)):
            jacobian[i, j] = out[i].imag / COMPLEX_STEP
    return jacobian


@compile_kernel
def shift_states(sensitivity, rate, times, sign, out):  # type: ignore[no-untyped-def]
    """Write to out (7, C) the derivatives (7, C) plus the product of `sign`, a rate (7,) and time shifts (C,)."""
    for i in range(7):
        for column in range(len(times)):
            out[i, column] = sensitivity[i, column] + sign * (rate[i] * times[column])


@compile_kernel
def propagate_through_cushion(  # type: ignore[no-untyped-def]
    sensitivity,
    s,
    before,
    after,
    kind,
    row,
    lines,
    arcs,
    normals,
    radius,
    mass,
    p,
    active,
    model,
    gentle,
    a,
    n,
    directions,
):
    """Propagate the derivatives (7, C) of ball a through a contact with a cushion.

    s (7,) is the state before; `before` and `after` (7,) are its time derivatives on both sides; radius in m, mass in
    kg; n is the number of balls.
    """
    nx, ny = cushion_normal(kind, row, s, lines, arcs)
    side = int(lines[row, 5]) if kind == LINE else int(arcs[row, 3])
    nose = directions[BALL_INPUTS * n + _PARAMETERS + side]
    by_radius, by_ball_mass = directions[BALL_INPUTS * a + _RADIUS], directions[BALL_INPUTS * a + _MASS]
    shift, by_mass = np.empty(len(nose)), np.bool_(False)
    for column in range(len(nose)):
        gap = -nx * sensitivity[0, column] - ny * sensitivity[1, column] - by_radius[column]
        gap += nose[column] * (nx * normals[side, 0] + ny * normals[side, 1])
        shift[column] = gap / (nx * before[0] + ny * before[1])
        by_mass = by_mass or by_ball_mass[column] != 0.0
    jacobian = differentiate_cushion_contact(
        s, kind, row, lines, arcs, normals, radius, mass, by_mass, p, active, model, gentle
    )
    inputs = np.empty((10 + len(active), sensitivity.shape[1]))
    shift_states(sensitivity, before, shift, 1.0, inputs)
    copy_numbers(by_radius, inputs[7])
    copy_numbers(by_ball_mass, inputs[8])
    copy_numbers(nose, inputs[9])
    for j in range(len(active)):
        copy_numbers(directions[BALL_INPUTS * n + active[j]], inputs[10 + j])
    outputs = jacobian @ inputs
    shift_states(outputs, after, shift, -1.0, outputs)
    return outputs


@compile_kernel
def propagate_through_ball(sa, sb, a, b, rates, ra, rb, ma, mb, p, active, model, gentle, i, j, n, directions):  # type: ignore[no-untyped-def]
    """Propagate the derivatives of balls i and j through their contact; the result is (14, C).

    sa, sb (7, C) are the derivatives and a, b (7,) the states before; rates (4, 7) are the time derivatives of a and b
    before and after; ra, rb in m; ma, mb in kg; n is the number of balls.
    """
    nx, ny = b[0] - a[0], b[1] - a[1]
    size = np.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    own, other, shift = BALL_INPUTS * i, BALL_INPUTS * j, np.empty(sa.shape[1])
    for column in range(len(shift)):
        gap = nx * (sb[0, column] - sa[0, column]) + ny * (sb[1, column] - sa[1, column])
        gap -= directions[own + _RADIUS, column] + directions[other + _RADIUS, column]
        shift[column] = -gap / (nx * (rates[1, 0] - rates[0, 0]) + ny * (rates[1, 1] - rates[0, 1]))
    jacobian = differentiate_ball_contact(a, b, ra, rb, ma, mb, p, active, model, gentle)
    inputs = np.empty((18 + len(active), sa.shape[1]))
    shift_states(sa, rates[0], shift, 1.0, inputs)
    shift_states(sb, rates[1], shift, 1.0, inputs[7:])
    copy_numbers(directions[own + _RADIUS], inputs[14])
    copy_numbers(directions[other + _RADIUS], inputs[15])
    copy_numbers(directions[own + _MASS], inputs[16])
    copy_numbers(directions[other + _MASS], inputs[17])
    for k in range(len(active)):
        copy_numbers(directions[BALL_INPUTS * n + active[k]], inputs[18 + k])
    outputs = jacobian @ inputs
    shift_states(outputs, rates[2], shift, -1.0, outputs)
    shift_states(outputs[7:], rates[3], shift, -1.0, outputs[7:])
    return outputs


@compile_kernel
def propagate_along_segment(  # type: ignore[no-untyped-def]
    segments,
    k,
    until,
    end,
    sensitivity,
    radius,
    p,
    active,
    times,
    place,
    directions,
    rows,
    phases,
    workspace,
    out,
    at_end,
):
    """Propagate derivatives along segment k up to the time `until` (s).

    Writes out (K, R, C) at the wanted times, and at_end (N, 7, C) if the segment contains the time `end`. sensitivity
    (7, C) are the derivatives at its start; returns those at `until`. rows, phases and workspace are room to work
    in.
    """
    ball, start = int(segments[k, SEGMENT_BALL]), segments[k, SEGMENT_TIME]
    first = np.searchsorted(times, start) if start > 0.0 else 0
    after = max(first, len(times) if until == np.inf else np.searchsorted(times, until))
    observed = first + np.flatnonzero(place[first:after, ball] >= 0)
    inputs = stack_ball_inputs(sensitivity, directions, ball, place.shape[1], active)
    numbers, columns = out.shape[1], len(inputs)
    needed = np.zeros(columns, np.bool_)
    for j in range(columns):
        for direction in range(inputs.shape[1]):
            needed[j] = needed[j] or inputs[j, direction] != 0.0
    parts, last = (
        workspace[: len(observed) * numbers * columns].reshape(len(observed), numbers, columns),
        np.empty((7, columns)),
    )
    stop, stopped = (end - start if start <= end < until else np.inf), np.empty((7, columns))
    _differentiate_motion(
        segments[k, SEGMENT_STATE:].copy(),
        radius[ball],
        p,
        active,
        needed,
        times[observed] - start,
        until - start,
        stop,
        rows,
        phases,
        parts,
        last,
        stopped,
    )
    if stop < np.inf:
        copy_rows(stopped @ inputs, at_end[ball])
    derivatives = parts.reshape(-1, columns) @ inputs
    for i in range(len(observed)):
        copy_rows(derivatives[i * numbers : (i + 1) * numbers], out[place[observed[i], ball]])
    return last @ inputs


@compile_kernel
def evaluate_rate(segment, until, radius, p, rows, phases, state, rate):  # type: ignore[no-untyped-def]
    """Write state (7,) and its time derivative, rate (7,), of a segment at the time `until` (s)."""
    count = plan_motion(
        segment[SEGMENT_STATE:], radius, p, until - segment[SEGMENT_TIME] + PLANNING_MARGIN, rows, phases
    )
    evaluate_pieces(rows, count, segment[SEGMENT_STATE + 6], p, until - segment[SEGMENT_TIME], state, rate)


@compile_kernel
def differentiate_shot(  # type: ignore[no-untyped-def]
    segments,
    contacts,
    pocket_times,
    radius,
    mass,
    p,
    model_codes,
    lines,
    arcs,
    normals,
    times,
    place,
    end,
    directions,
    active,
    out,
    at_end,
):
    """Differentiate the states of balls along directions.

    Args:
        segments: (L, SEGMENT_WIDTH) by ball, then by time.
        contacts: (E, EVENT_WIDTH) by time.
        pocket_times: (N,) s, infinite for balls that stay on the table.
        radius: (N,) m.
        mass: (N,) kg.
        p: (P,) physical parameters.
        model_codes: Codes of the cushion model and of the ball model.
        lines: (L, 6) as in `cushion_geometry.Rails`.
        arcs: (A, 4) as in `cushion_geometry.Rails`.
        normals: (4, 2) unit normals into the cushions.
        times: (T,) s, sorted.
        place: (T, N) row of `out` for each ball and time, -1 where none is wanted.
        end: s; infinite if no derivatives at an end are wanted.
        directions: (9 N + P + 4, C).
        active: (A,) parameters that a direction changes.
        out: (K, R, C) receives derivatives of the first R, 2 or 7, numbers of a state.
        at_end: (N, 7, C) receives the derivatives of all balls at `end`.
    """
    n, columns, has_curves = len(radius), directions.shape[1], has_curved_path(p)
    for parameter in active:  # a derivative by an effect that is absent has no closed form either
        has_curves = has_curves or parameter in PATH_BENDING_PARAMETERS
    piece_capacity = count_pieces(has_curves)
    rows, phases = np.zeros((piece_capacity, PIECE_WIDTH)), np.zeros(piece_capacity, np.int64)
    complex_rows = np.zeros((piece_capacity, PIECE_WIDTH), np.complex128)
    workspace = np.empty(len(times) * out.shape[1] * (8 + len(active)))
    sens, segment = np.zeros((n, 7, columns)), np.zeros(n, np.int64)
    for k in range(len(segments) - 1, -1, -1):
        segment[int(segments[k, SEGMENT_BALL])] = k
    for a in range(n):
        copy_rows(directions[BALL_INPUTS * a : BALL_INPUTS * a + 7], sens[a])
    states, rates, unused = np.zeros((2, 7)), np.zeros((4, 7)), np.zeros(7)
    for e in range(len(contacts)):
        t, a, b = contacts[e, EVENT_TIME], int(contacts[e, EVENT_FIRST]), int(contacts[e, EVENT_SECOND])
        kind, gentle = int(contacts[e, EVENT_KIND]), contacts[e, EVENT_GENTLE] > 0.0
        for m in range(2 if kind == BALL else 1):
            ball = a if m == 0 else b
            k = segment[ball]
            sensitivity = propagate_along_segment(
                segments, k, t, end, sens[ball], radius, p, active, times, place, directions, complex_rows,
                phases, workspace, out, at_end,
            )  # fmt: skip
            copy_rows(sensitivity, sens[ball])
            segment[ball] = k + 1
            evaluate_rate(segments[k], t, radius[ball], p, rows, phases, states[m], rates[m])
            evaluate_rate(segments[k + 1], t, radius[ball], p, rows, phases, unused, rates[2 + m])
        if kind == BALL:
            both = propagate_through_ball(
                sens[a], sens[b], states[0], states[1], rates, radius[a], radius[b], mass[a], mass[b],
                p, active, model_codes[1], gentle, a, b, n, directions,
            )  # fmt: skip
            copy_rows(both[:7], sens[a])
            copy_rows(both[7:], sens[b])
        elif kind != HOLE:
            sensitivity = propagate_through_cushion(
                sens[a], states[0], rates[0], rates[2], kind, b, lines, arcs, normals, radius[a], mass[a],
                p, active, model_codes[0], gentle, a, n, directions,
            )  # fmt: skip
            copy_rows(sensitivity, sens[a])
    for a in range(n):
        if pocket_times[a] == np.inf:
            propagate_along_segment(
                segments,
                segment[a],
                np.inf,
                end,
                sens[a],
                radius,
                p,
                active,
                times,
                place,
                directions,
                complex_rows,
                phases,
                workspace,
                out,
                at_end,
            )


_SIDE_SPIN = 6
# s by which a segment is planned beyond the last time that is wanted.
PLANNING_MARGIN = 1e-9


@compile_kernel
def _differentiate_motion(  # type: ignore[no-untyped-def]
    state, radius, p, active, needed, taus, until, stop, rows, phases, at_times, last, stopped
):
    """Differentiate one ball's motion by its state, its radius and the active parameters.

    Args:
        state: (7,) at the initial state of the segment.
        radius: m.
        p: (P,) physical parameters.
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
        count = plan_motion(s, r, q, horizon + PLANNING_MARGIN, rows, phases)
        if at_times.shape[1] == 2:
            _fill_place_derivatives(s, rows, phases, count, taus, at_times, j)
        else:
            for i in range(len(taus)):
                _fill_state_derivatives(s, q, rows, count, taus[i], at_times[i], j)
        if until < np.inf:
            _fill_state_derivatives(s, q, rows, count, until, last, j)
        if stop < np.inf:
            _fill_state_derivatives(s, q, rows, count, stop, stopped, j)


@compile_kernel
def _fill_place_derivatives(s, rows, phases, count, taus, at_times, j):  # type: ignore[no-untyped-def]
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
def _fill_state_derivatives(s, q, rows, count, tau, out, j):  # type: ignore[no-untyped-def]
    """Write column j of out (7, ...) at tau (s) from planned pieces whose numbers carry a step."""
    if tau == 0.0:
        for i in range(7):
            out[i, j] = s[i].imag / COMPLEX_STEP
        return
    state, turn = np.zeros(7, np.complex128), np.zeros(7, np.complex128)
    evaluate_pieces(rows, count, s[6], q, tau + 0j, state, turn)
    for i in range(7):
        out[i, j] = state[i].imag / COMPLEX_STEP
