"""Motion of the mass-spring-damper model with its tangents: derivatives of ends by initial states and parameters.

A Runge-Kutta step is differentiated as it is taken (internal differentiation, Bock 1983,
doi:10.1007/978-1-4684-3324-1_15), so that the derivatives are those of the steps, exact to rounding. Tangents are
arrays (N D, M) by M inputs, with the innermost loops over inputs. The forces are those of
`models.physics.springs.spring_kernels`; a test compares these tangents with its complex step.

Arguments that the functions share, besides those of `spring_kernels`: tangent (2, N D, M) of a state; parameters as
`SpringSystem.parameters`; input_of, the input (M) that each parameter is, -1 for none; by_..., the input that a number
is, -1 for none; rate_tangents (N D, M) of accelerations.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.springs.spring_kernels import BAUMGARTE, fill_accelerations, rod_coupling, solve_by_elimination


@compile_kernel
def integrate_with_tangents(  # type: ignore[no-untyped-def]
    starts, spans, steps, tableau, shares, fixed, parameters, pairs, rods, touching, inputs, ends, slopes
):
    """Integrate K segments of motion with their tangents.

    Args:
        starts: (K, 2, N, D) states.
        spans: (K,) s.
        steps: (K,) numbers of steps.
        tableau: (stages, stages) Runge-Kutta matrix.
        shares: (stages,) Runge-Kutta weights.
        fixed: (N,) particles that never move.
        parameters: As `SpringSystem.parameters`.
        pairs: (E, 2) joined particles.
        rods: (R,) rows of the pairs that keep their length.
        touching: (C, 2) pairs that collide.
        inputs: (M,) below 2 N D a number of the start, from there on one of `parameters`.
        ends: (K, 2, N, D) receives the states at the end.
        slopes: (K, 2 N D, M) receives their derivatives.
    """
    particles, axes = starts.shape[2:]
    count, half = len(inputs), particles * axes
    input_of = np.full(len(parameters), -1)
    for m in range(count):
        if inputs[m] >= 2 * half:
            input_of[inputs[m] - 2 * half] = m
    tangent = np.empty((2, half, count))
    for k in range(len(starts)):
        ends[k] = starts[k]
        tangent[:] = 0.0
        for m in range(count):
            if inputs[m] < 2 * half:
                tangent[inputs[m] // half, inputs[m] % half, m] = 1.0
        advance_with_tangents(
            ends[k],
            tangent,
            spans[k] / steps[k],
            steps[k],
            tableau,
            shares,
            fixed,
            parameters,
            pairs,
            rods,
            touching,
            input_of,
        )
        slopes[k] = tangent.reshape(2 * half, count)


@compile_kernel
def advance_with_tangents(  # type: ignore[no-untyped-def]
    state, tangent, dt, steps, tableau, shares, fixed, parameters, pairs, rods, touching, input_of
):
    """Move a state (2, N, D) and its tangent by `steps` explicit Runge-Kutta steps of dt (s), in place."""
    particles, axes = state.shape[1:]
    stages, half, count = len(shares), particles * axes, tangent.shape[2]
    rates = np.zeros((stages, 2, particles, axes))
    rate_tangents = np.zeros((stages, 2, half, count))
    stage_state, stage_tangent = np.zeros_like(state), np.zeros_like(tangent)
    for _ in range(steps):
        for s in range(stages):
            stage_state[:], stage_tangent[:] = state, tangent
            for earlier in range(s):
                weight = dt * tableau[s, earlier]
                if weight != 0.0:
                    add_scaled(stage_state.reshape(-1), weight, rates[earlier].reshape(-1))
                    add_scaled(stage_tangent.reshape(-1), weight, rate_tangents[earlier].reshape(-1))
            rates[s, 0], rate_tangents[s, 0] = stage_state[1], stage_tangent[1]
            fill_acceleration_tangents(
                stage_state, stage_tangent, fixed, parameters, pairs, rods, touching, input_of, rates[s, 1],
                rate_tangents[s, 1],
            )  # fmt: skip
        for s in range(stages):
            add_scaled(state.reshape(-1), dt * shares[s], rates[s].reshape(-1))
            add_scaled(tangent.reshape(-1), dt * shares[s], rate_tangents[s].reshape(-1))


@compile_kernel
def add_scaled(to, weight, what):  # type: ignore[no-untyped-def]
    """Add `weight` times `what` to the flat array `to`."""
    for k in range(len(to)):
        to[k] += weight * what[k]


@compile_kernel
def fill_acceleration_tangents(at, tangent, fixed, parameters, pairs, rods, touching, input_of, a, rate_tangents):  # type: ignore[no-untyped-def]
    """Write the accelerations a (N, D) at a state (2, N, D), and their tangents."""
    particles, axes = a.shape
    edges, count = len(pairs), rate_tangents.shape[1]
    x, v = at
    mass, stiffness = parameters[:particles], parameters[particles : particles + edges]
    damping, rest = (
        parameters[particles + edges : particles + 2 * edges],
        parameters[particles + 2 * edges : particles + 3 * edges],
    )
    after = particles + 3 * edges
    gravity, radius = parameters[after : after + axes], parameters[after + axes : after + axes + particles]
    contact = parameters[after + axes + particles :]
    none = rods[:0]
    fill_accelerations(x, v, fixed, mass, stiffness, damping, rest, gravity, radius, contact, pairs, none, touching, a)
    if count > 0:
        rate_tangents[:] = 0.0
        for e in range(edges):
            if (
                stiffness[e] != 0.0
                or damping[e] != 0.0
                or input_of[particles + e] >= 0
                or input_of[particles + edges + e] >= 0
            ):
                add_spring_tangents(
                    x,
                    v,
                    tangent,
                    pairs[e, 0],
                    pairs[e, 1],
                    stiffness[e],
                    damping[e],
                    rest[e],
                    False,
                    input_of[particles + e],
                    input_of[particles + edges + e],
                    input_of[particles + 2 * edges + e],
                    -1,
                    rate_tangents,
                )
        spring, damper = input_of[after + axes + particles], input_of[after + axes + particles + 1]
        for c in range(len(touching)):
            i, j = touching[c]
            add_spring_tangents(
                x,
                v,
                tangent,
                i,
                j,
                contact[0],
                contact[1],
                radius[i] + radius[j],
                True,
                spring,
                damper,
                input_of[after + axes + i],
                input_of[after + axes + j],
                rate_tangents,
            )
        divide_by_mass(a, fixed, mass, gravity, input_of[:particles], input_of[after : after + axes], rate_tangents)
    if len(rods) > 0:
        add_rod_tangents(
            x,
            v,
            tangent,
            fixed,
            mass,
            rest,
            pairs,
            rods,
            input_of[:particles],
            input_of[particles + 2 * edges : after],
            a,
            rate_tangents,
        )


@compile_kernel
def add_spring_tangents(  # type: ignore[no-untyped-def]
    x, v, tangent, i, j, stiffness, damping, rest, pushes_only, by_k, by_c, by_rest, by_other, rate_tangents
):
    """Add the tangents of the force of one spring and damper (Chen 2022, equations 3 and 5)."""
    axes, count = x.shape[1], rate_tangents.shape[1]
    square = along = 0.0
    for axis in range(axes):
        apart = x[j, axis] - x[i, axis]
        square += apart * apart
        along += apart * (v[j, axis] - v[i, axis])
    length = np.sqrt(square)
    if pushes_only and length >= rest:
        return
    tension = stiffness * (1 - rest / length) + damping * along / square
    by_stretch = stiffness * rest / (square * length) - 2 * damping * along / (square * square)
    more = np.zeros(count)
    for axis in range(axes):
        p, q = i * axes + axis, j * axes + axis
        d, w = x[j, axis] - x[i, axis], v[j, axis] - v[i, axis]
        lengthened, rubbed = by_stretch * d + damping * w / square, damping * d / square
        here, there, slow, fast = tangent[0, p], tangent[0, q], tangent[1, p], tangent[1, q]
        for m in range(count):
            more[m] += lengthened * (there[m] - here[m]) + rubbed * (fast[m] - slow[m])
    for axis in range(axes):
        p, q, d = i * axes + axis, j * axes + axis, x[j, axis] - x[i, axis]
        here, there, one, other = tangent[0, p], tangent[0, q], rate_tangents[p], rate_tangents[q]
        for m in range(count):
            share = more[m] * d + tension * (there[m] - here[m])
            one[m] += share
            other[m] -= share
    for axis in range(axes):
        p, q, d = i * axes + axis, j * axes + axis, x[j, axis] - x[i, axis]
        for m, slope in (
            (by_k, 1 - rest / length),
            (by_c, along / square),
            (by_rest, -stiffness / length),
            (by_other, -stiffness / length),
        ):
            if m >= 0:
                rate_tangents[p, m] += slope * d
                rate_tangents[q, m] -= slope * d


@compile_kernel
def divide_by_mass(a, fixed, mass, gravity, by_mass, by_gravity, rate_tangents):  # type: ignore[no-untyped-def]
    """Convert tangents of forces to those of accelerations."""
    particles, axes = a.shape
    for i in range(particles):
        for axis in range(axes):
            row = rate_tangents[i * axes + axis]
            if fixed[i]:
                row[:] = 0.0
                continue
            row /= mass[i]
            if by_mass[i] >= 0:
                row[by_mass[i]] -= (a[i, axis] - gravity[axis]) / mass[i]
            if by_gravity[axis] >= 0:
                row[by_gravity[axis]] += 1.0


@compile_kernel
def add_rod_tangents(x, v, tangent, fixed, mass, rest, pairs, rods, by_mass, by_rest, a, rate_tangents):  # type: ignore[no-untyped-def]
    """Add the forces of rods to a and to its tangents: the derivative of `spring_kernels.add_rod_forces`."""
    count, axes, wide = len(rods), x.shape[1], rate_tangents.shape[1]
    system, pulls = np.zeros((count, count + 1)), np.zeros((count, count + wide))
    for r in range(count):
        i, j = pairs[rods[r]]
        length = rest[rods[r]]
        off_length, speed, rate = -length * length, 0.0, 0.0
        for axis in range(axes):
            p, q = i * axes + axis, j * axes + axis
            d, w, pull = x[j, axis] - x[i, axis], v[j, axis] - v[i, axis], a[j, axis] - a[i, axis]
            off_length += d * d
            speed += d * w
            rate += w * w + d * pull
            for m in range(wide):
                dd, dw = tangent[0, q, m] - tangent[0, p, m], tangent[1, q, m] - tangent[1, p, m]
                pulls[r, count + m] += (
                    2 * w * dw
                    + dd * pull
                    + d * (rate_tangents[q, m] - rate_tangents[p, m])
                    + 2 * BAUMGARTE * (dd * w + d * dw)
                    + BAUMGARTE * BAUMGARTE * d * dd
                )
        if by_rest[rods[r]] >= 0:
            pulls[r, count + by_rest[rods[r]]] -= BAUMGARTE * BAUMGARTE * length
        system[r, count] = rate + 2 * BAUMGARTE * speed + 0.5 * BAUMGARTE * BAUMGARTE * off_length
        for other in range(count):
            g, h = pairs[rods[other]]
            system[r, other] = pulls[r, other] = rod_coupling(x, fixed, mass, i, j, g, h)
    solve_by_elimination(system)
    if wide > 0:
        for r in range(count):
            for other in range(count):
                subtract_coupling_change(
                    x,
                    tangent,
                    fixed,
                    mass,
                    pairs[rods[r]],
                    pairs[rods[other]],
                    by_mass,
                    system[other, count],
                    pulls[r, count:],
                )
        solve_by_elimination(pulls)
    for r in range(count):
        add_rod_pull(
            x, tangent, fixed, mass, pairs[rods[r]], by_mass, system[r, count], pulls[r, count:], a, rate_tangents
        )


@compile_kernel
def common_end_weights(fixed, mass, rod, other):  # type: ignore[no-untyped-def]
    """Return one over mass at both ends of a rod that the other rod shares, with the sign of its tension there."""
    i, j = rod
    p, q = other
    at_i = at_j = 0.0
    if not fixed[i]:
        at_i = ((1.0 if i == p else 0.0) - (1.0 if i == q else 0.0)) / mass[i]
    if not fixed[j]:
        at_j = ((1.0 if j == q else 0.0) - (1.0 if j == p else 0.0)) / mass[j]
    return at_i, at_j


@compile_kernel
def subtract_coupling_change(x, tangent, fixed, mass, rod, other, by_mass, pull, row):  # type: ignore[no-untyped-def]
    """Subtract from row (M,) the change of the coupling of two rods times the tension of the other one."""
    axes = x.shape[1]
    at_i, at_j = common_end_weights(fixed, mass, rod, other)
    i, j = rod
    p, q = other
    if at_i == 0.0 and at_j == 0.0:
        return
    along = 0.0
    for axis in range(axes):
        d, f = x[j, axis] - x[i, axis], x[q, axis] - x[p, axis]
        along += d * f
        for m in range(len(row)):
            dd = tangent[0, j * axes + axis, m] - tangent[0, i * axes + axis, m]
            df = tangent[0, q * axes + axis, m] - tangent[0, p * axes + axis, m]
            row[m] -= pull * (at_i + at_j) * (dd * f + d * df)
    if by_mass[i] >= 0:
        row[by_mass[i]] += pull * at_i / mass[i] * along
    if by_mass[j] >= 0:
        row[by_mass[j]] += pull * at_j / mass[j] * along


@compile_kernel
def add_rod_pull(x, tangent, fixed, mass, rod, by_mass, pull, pulls, a, rate_tangents):  # type: ignore[no-untyped-def]
    """Add the tension of one rod to the accelerations of its ends, and to their tangents."""
    axes = x.shape[1]
    i, j = rod
    for end, sign in ((i, 1.0), (j, -1.0)):
        if fixed[end]:
            continue
        for axis in range(axes):
            d, row = x[j, axis] - x[i, axis], end * axes + axis
            a[end, axis] += sign * pull * d / mass[end]
            for m in range(len(pulls)):
                dd = tangent[0, j * axes + axis, m] - tangent[0, i * axes + axis, m]
                rate_tangents[row, m] += sign * (pulls[m] * d + pull * dd) / mass[end]
            if by_mass[end] >= 0:
                rate_tangents[row, by_mass[end]] -= sign * pull * d / mass[end] ** 2
