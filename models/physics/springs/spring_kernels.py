"""Compiled accelerations of the mass-spring-damper model, for real and for complex numbers.

With float64 they are those of the motion, with complex128 and a step of 1e-30 along the imaginary axis their
derivative, exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X). So the functions branch on real
parts and do not use abs, min or max of numbers that can be complex.

Arguments that the functions share: x, v (N, D) places and velocities; fixed (N,) particles that never move; mass (N,);
stiffness, damping, rest (E,) of the pairs (E, 2); rods (R,) rows of the pairs that keep their length; a (N, D)
accelerations. Units are the caller's, see `spring_system`.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel

# 1/s; rate at which a rod that is off its length returns to it (Baumgarte 1972, doi:10.1016/0045-7825(72)90018-7).
BAUMGARTE = 20.0
# Part of the largest pivot below which a rod is redundant to others.
LEAST_PIVOT = 1e-9


@compile_kernel
def fill_accelerations(x, v, fixed, mass, stiffness, damping, rest, gravity, radius, contact, pairs, rods, touching, a):  # type: ignore[no-untyped-def]
    """Write the accelerations of all particles (Chen 2022, equations 1 to 7).

    Args:
        x: (N, D) places.
        v: (N, D) velocities.
        fixed: (N,) particles that never move.
        mass: (N,) masses.
        stiffness: (E,) of the springs, 0 for rods.
        damping: (E,) of the dampers.
        rest: (E,) length without tension.
        gravity: (D,) acceleration.
        radius: (N,) of the surfaces that collide.
        contact: (2,) stiffness and damping of collisions.
        pairs: (E, 2) joined particles.
        rods: (R,) rows of the pairs that keep their length.
        touching: (C, 2) pairs that collide below the sum of their radii.
        a: (N, D) receives the accelerations.
    """
    particles, axes = x.shape
    a[:] = 0.0
    for e in range(len(pairs)):
        add_spring_force(x, v, pairs[e, 0], pairs[e, 1], stiffness[e], damping[e], rest[e], False, a)
    for c in range(len(touching)):
        i, j = touching[c]
        add_spring_force(x, v, i, j, contact[0], contact[1], radius[i] + radius[j], True, a)
    for i in range(particles):
        for axis in range(axes):
            a[i, axis] = 0.0 if fixed[i] else a[i, axis] / mass[i] + gravity[axis]
    if len(rods) > 0:
        add_rod_forces(x, v, fixed, mass, rest, pairs, rods, a)


@compile_kernel
def add_spring_force(x, v, i, j, stiffness, damping, rest, pushes_only, force):  # type: ignore[no-untyped-def]
    """Add the force of one spring and damper between particles i and j to force (N, D) (equations 3 and 5).

    With pushes_only it acts only below the length `rest`.
    """
    square = x[0, 0] * 0.0
    along = x[0, 0] * 0.0
    for axis in range(x.shape[1]):
        apart = x[j, axis] - x[i, axis]
        square += apart * apart
        along += apart * (v[j, axis] - v[i, axis])
    length = np.sqrt(square)
    if pushes_only and length.real >= rest.real:
        return
    tension = (stiffness * (length - rest) + damping * along / length) / length
    for axis in range(x.shape[1]):
        share = tension * (x[j, axis] - x[i, axis])
        force[i, axis] += share
        force[j, axis] -= share


@compile_kernel
def add_rod_forces(x, v, fixed, mass, rest, pairs, rods, a):  # type: ignore[no-untyped-def]
    """Add the forces by which rods keep their lengths: Lagrange multipliers, found by elimination.

    With d the vector along a rod and w its rate, d.d - s^2 obeys y'' + 2 B y' + B^2 y = 0.
    """
    count, axes = len(rods), x.shape[1]
    gram = np.zeros((count, count + 1), x.dtype)
    for r in range(count):
        i, j = pairs[rods[r]]
        off, speed, rate = -rest[rods[r]] * rest[rods[r]], x[0, 0] * 0.0, x[0, 0] * 0.0
        for axis in range(axes):
            d, w = x[j, axis] - x[i, axis], v[j, axis] - v[i, axis]
            off += d * d
            speed += d * w
            rate += w * w + d * (a[j, axis] - a[i, axis])
        gram[r, count] = rate + 2 * BAUMGARTE * speed + 0.5 * BAUMGARTE * BAUMGARTE * off
        for other in range(count):
            gram[r, other] = rod_coupling(x, fixed, mass, i, j, pairs[rods[other], 0], pairs[rods[other], 1])
    solve_by_elimination(gram)
    for r in range(count):
        i, j = pairs[rods[r]]
        for axis in range(axes):
            push = gram[r, count] * (x[j, axis] - x[i, axis])
            if not fixed[i]:
                a[i, axis] += push / mass[i]
            if not fixed[j]:
                a[j, axis] -= push / mass[j]


@compile_kernel
def rod_coupling(x, fixed, mass, i, j, p, q):  # type: ignore[no-untyped-def]
    """Return how much a unit tension in rod p-q shortens rod i-j, per time squared."""
    inverse = x[0, 0] * 0.0
    if i == p and not fixed[i]:
        inverse += 1 / mass[i]
    if i == q and not fixed[i]:
        inverse -= 1 / mass[i]
    if j == q and not fixed[j]:
        inverse += 1 / mass[j]
    if j == p and not fixed[j]:
        inverse -= 1 / mass[j]
    along = x[0, 0] * 0.0
    for axis in range(x.shape[1]):
        along += (x[j, axis] - x[i, axis]) * (x[q, axis] - x[p, axis])
    return inverse * along


@compile_kernel
def solve_by_elimination(system):  # type: ignore[no-untyped-def]
    """Solve (R, R + Q) equations of a positive definite matrix in place; the last Q columns become the solutions.

    A rod that others make redundant carries no tension.
    """
    count, wide = system.shape
    largest = 0.0
    for r in range(count):
        largest = max(largest, system[r, r].real)
    for r in range(count):
        if system[r, r].real <= LEAST_PIVOT * largest:
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
