"""Compiled motion of the mass-spring-damper model with its tangents: derivatives by initial states and parameters.

A Runge-Kutta step is differentiated as it is taken (internal differentiation, Bock 1983,
doi:10.1007/978-1-4684-3324-1_15), so that the derivatives are those of the steps, exact to rounding.

Arguments that the functions share: at (2, N, D, 1 + M) places and velocities, each followed by its derivatives by M
inputs; force (N, D, 1 + M), which is divided by the masses to become the acceleration, laid out alike; parameters as
`SpringSystem.parameters`, and input_of, the column of `at` of the input that each of them is, 0 for none; fixed (N,)
particles that never move; pairs (E, 2), rods (R,) rows of the pairs that keep their length, and touching (C, 2)
pairs that collide. Units are the caller's, see `spring_system`.
"""

from __future__ import annotations

import numpy as np

from models.numerics.integrators import build_step_loop
from models.numerics.jit import compile_kernel

# 1/s; rate at which a rod that is off its length returns to it (Baumgarte 1972, doi:10.1016/0045-7825(72)90018-7).
BAUMGARTE = 20.0
# Part of the largest pivot below which a rod is redundant to others.
LEAST_PIVOT = 1e-9


@compile_kernel
def add_spring_force(at, i, j, stiffness, damping, rest, pushes_only, columns, force):  # type: ignore[no-untyped-def]
    """Add the force of one spring and damper between particles i and j (Chen 2022, equations 3 and 5).

    `columns` are those of its stiffness, damping, rest length and a second rest length that is added to the first. With
    pushes_only it acts only below the rest length.
    """
    axes, wide = force.shape[1:]
    square = along = 0.0
    for axis in range(axes):
        apart = at[0, j, axis, 0] - at[0, i, axis, 0]
        square += apart * apart
        along += apart * (at[1, j, axis, 0] - at[1, i, axis, 0])
    length = np.sqrt(square)
    if pushes_only and length >= rest:
        return
    tension = np.zeros(wide)  # over the length, and its derivatives
    tension[0] = stiffness * (1 - rest / length) + damping * along / square
    slopes = (1 - rest / length, along / square, -stiffness / length, -stiffness / length)
    for column, slope in zip(columns, slopes):  # noqa: B905 - numba knows no strict
        if column > 0:
            tension[column] += slope
    by_stretch = stiffness * rest / (square * length) - 2 * damping * along / (square * square)
    for axis in range(axes):
        apart, rate = at[0, j, axis, 0] - at[0, i, axis, 0], at[1, j, axis, 0] - at[1, i, axis, 0]
        by_place, by_speed = by_stretch * apart + damping * rate / square, damping * apart / square
        for m in range(1, wide):
            tension[m] += by_place * (at[0, j, axis, m] - at[0, i, axis, m])
            tension[m] += by_speed * (at[1, j, axis, m] - at[1, i, axis, m])
    for axis in range(axes):
        apart = at[0, j, axis, 0] - at[0, i, axis, 0]
        for m in range(wide):
            share = tension[m] * apart
            if m > 0:
                share += tension[0] * (at[0, j, axis, m] - at[0, i, axis, m])
            force[i, axis, m] += share
            force[j, axis, m] -= share


@compile_kernel
def fill_accelerations(at, parameters, input_of, fixed, pairs, rods, touching, force):  # type: ignore[no-untyped-def]
    """Write the accelerations of all particles (Chen 2022, equations 1 to 7), and their derivatives, to `force`."""
    particles, axes, wide = force.shape
    edges = len(pairs)
    stiffness, damping, rest = particles, particles + edges, particles + 2 * edges
    gravity, radius, contact = rest + edges, rest + edges + axes, rest + edges + axes + particles
    force[:] = 0.0
    for e in range(edges):
        columns = input_of[stiffness + e], input_of[damping + e], input_of[rest + e], 0
        k, c = parameters[stiffness + e], parameters[damping + e]
        if k != 0.0 or c != 0.0 or columns[0] > 0 or columns[1] > 0:
            add_spring_force(at, pairs[e, 0], pairs[e, 1], k, c, parameters[rest + e], False, columns, force)
    for pair in range(len(touching)):
        i, j = touching[pair]
        columns = input_of[contact], input_of[contact + 1], input_of[radius + i], input_of[radius + j]
        reach = parameters[radius + i] + parameters[radius + j]
        add_spring_force(at, i, j, parameters[contact], parameters[contact + 1], reach, True, columns, force)
    for i in range(particles):
        for axis in range(axes):
            acceleration = force[i, axis]
            for m in range(wide):
                acceleration[m] = 0.0 if fixed[i] else acceleration[m] / parameters[i]
            if not fixed[i]:
                if input_of[i] > 0:
                    acceleration[input_of[i]] -= acceleration[0] / parameters[i]
                acceleration[0] += parameters[gravity + axis]
                if input_of[gravity + axis] > 0:
                    acceleration[input_of[gravity + axis]] += 1.0
    if len(rods) > 0:
        add_rod_forces(at, parameters, input_of, fixed, pairs[rods], rest + rods, force)


@compile_kernel
def add_rod_forces(at, parameters, input_of, fixed, pairs, lengths, force):  # type: ignore[no-untyped-def]
    """Add the accelerations by which rods (R, 2) keep their lengths: Lagrange multipliers, found by elimination.

    With d the vector along a rod and w its rate, d.d - s^2 obeys y'' + 2 B y' + B^2 y = 0, and so do its derivatives:
    those of the multipliers remove what is left of them at constant multipliers. `lengths` (R,) are the rows of s in
    `parameters`.
    """
    axes, wide, count = force.shape[1], force.shape[2], len(pairs)
    coupling = np.zeros((count, count))
    for r in range(count):
        for other in range(count):
            (i, j), (p, q), inverse, along = pairs[r], pairs[other], 0.0, 0.0
            if not fixed[i]:
                inverse += ((i == p) - (i == q)) / parameters[i]
            if not fixed[j]:
                inverse += ((j == q) - (j == p)) / parameters[j]
            for axis in range(axes):
                along += (at[0, j, axis, 0] - at[0, i, axis, 0]) * (at[0, q, axis, 0] - at[0, p, axis, 0])
            coupling[r, other] = inverse * along
    for first, last in ((0, 1), (1, wide)):  # the multipliers, then their derivatives
        system = np.zeros((count, count + last - first))
        for r in range(count):
            (i, j), length = pairs[r], parameters[lengths[r]]
            for m in range(first, last):
                system[r, count + m - first] = rod_residual(at, force, i, j, length, m)
            if first == 1 and input_of[lengths[r]] > 0:
                system[r, count + input_of[lengths[r]] - 1] -= BAUMGARTE * BAUMGARTE * length
            for other in range(count):
                system[r, other] = coupling[r, other]
        solve_by_elimination(system)
        for r in range(count):
            i, j = pairs[r]
            for end, sign in ((i, 1.0), (j, -1.0)):
                for axis in range(axes if not fixed[end] else 0):
                    apart = sign * (at[0, j, axis, 0] - at[0, i, axis, 0]) / parameters[end]
                    for m in range(first, last):
                        force[end, axis, m] += system[r, count + m - first] * apart
                    if first == 0:
                        for m in range(1, wide):
                            change = sign * (at[0, j, axis, m] - at[0, i, axis, m]) / parameters[end]
                            force[end, axis, m] += system[r, count] * change
                        if input_of[end] > 0:
                            force[end, axis, input_of[end]] -= system[r, count] * apart / parameters[end]


@compile_kernel
def rod_residual(at, acceleration, i, j, length, m):  # type: ignore[no-untyped-def]
    """Return half of y'' + 2 B y' + B^2 y of a rod, see `add_rod_forces`, or its derivative by column m > 0."""
    total = -0.5 * BAUMGARTE * BAUMGARTE * length * length if m == 0 else 0.0
    for axis in range(at.shape[2]):
        d, w = at[0, j, axis, 0] - at[0, i, axis, 0], at[1, j, axis, 0] - at[1, i, axis, 0]
        pull = acceleration[j, axis, 0] - acceleration[i, axis, 0]
        if m == 0:
            total += w * w + d * pull + 2 * BAUMGARTE * d * w + 0.5 * BAUMGARTE * BAUMGARTE * d * d
            continue
        by_place, by_speed = pull + 2 * BAUMGARTE * w + BAUMGARTE * BAUMGARTE * d, 2 * w + 2 * BAUMGARTE * d
        total += by_place * (at[0, j, axis, m] - at[0, i, axis, m]) + by_speed * (at[1, j, axis, m] - at[1, i, axis, m])
        total += d * (acceleration[j, axis, m] - acceleration[i, axis, m])
    return total


@compile_kernel
def solve_by_elimination(system):  # type: ignore[no-untyped-def]
    """Solve (R, R + Q) equations of a positive definite matrix in place; the last Q columns become the solutions.

    A rod that others make redundant carries no tension.
    """
    count, wide = system.shape
    largest = 0.0
    for r in range(count):
        largest = max(largest, system[r, r])
    for r in range(count):
        if system[r, r] <= LEAST_PIVOT * largest:
            system[r, :] = 0.0
            system[:, r] = 0.0
            system[r, r] = 1.0
            continue
        for below in range(r + 1, count):
            share = system[below, r] / system[r, r]
            for column in range(r, wide):
                system[below, column] -= share * system[r, column]
    for r in range(count - 1, -1, -1):
        for solution in range(count, wide):
            for column in range(r + 1, count):
                system[r, solution] -= system[r, column] * system[column, solution]
            system[r, solution] /= system[r, r]


@compile_kernel
def fill_spring_rate(flat, arguments, rate):  # type: ignore[no-untyped-def]
    """Write the rate of a flat state `at` for `build_step_loop`; `arguments` are its axes and those of the forces."""
    axes, parameters, input_of, fixed, pairs, rods, touching = arguments
    shape = 2, len(fixed), axes, len(flat) // (2 * len(fixed) * axes)
    at, rates = flat.reshape(shape), rate.reshape(shape)
    rates[0] = at[1]
    fill_accelerations(at, parameters, input_of, fixed, pairs, rods, touching, rates[1])


take_spring_steps = build_step_loop(fill_spring_rate)


@compile_kernel
def integrate_segments(starts, spans, steps, inputs, parameters, fixed, pairs, rods, touching, ends, slopes):  # type: ignore[no-untyped-def]
    """Integrate K segments of motion with their tangents.

    Args:
        starts: (K, 2, N, D) states.
        spans: (K,) s.
        steps: (K,) numbers of steps.
        inputs: (M,) below 2 N D a number of the start, from there on one of `parameters`.
        parameters: As `SpringSystem.parameters`.
        fixed: (N,) particles that never move.
        pairs: (E, 2) joined particles.
        rods: (R,) rows of the pairs that keep their length.
        touching: (C, 2) pairs that collide.
        ends: (K, 2, N, D) receives the states at the end.
        slopes: (K, 2 N D, M) receives their derivatives.
    """
    size, count = slopes.shape[1:]
    input_of = np.zeros(len(parameters), np.int64)
    for m in range(count):
        if inputs[m] >= size:
            input_of[inputs[m] - size] = m + 1
    arguments = starts.shape[3], parameters, input_of, fixed, pairs, rods, touching
    for k in range(len(starts)):
        state = np.zeros((size, 1 + count))
        state[:, 0] = starts[k].reshape(-1)
        for m in range(count):
            if inputs[m] < size:
                state[inputs[m], 1 + m] = 1.0
        take_spring_steps(state.reshape(-1), arguments, spans[k] / steps[k], steps[k])
        ends[k] = state[:, 0].copy().reshape(ends.shape[1:])
        slopes[k] = state[:, 1:]
