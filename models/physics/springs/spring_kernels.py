"""The compiled heart of the mass-spring-damper model: accelerations, for real and for complex numbers.

With float64 they are those of the motion, with complex128 and a step of 1e-30 along the imaginary axis their
derivative, exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X). So this branches on real parts and
has no abs, min or max of what can be complex.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled

BAUMGARTE = 20.0
"""1/s: how fast a rod that is off its length returns to it (Baumgarte 1972, doi:10.1016/0045-7825(72)90018-7)."""
LEAST_PIVOT = 1e-9
"""of the largest: below it a rod repeats what other rods say already."""


@compiled
def accelerate(x, v, held, mass, stiffness, damping, rest, gravity, radius, contact, pairs, rods, touching, a):  # type: ignore[no-untyped-def]
    """Chen 2022, eqs 1 to 7: writes accelerations a (N, D) of particles at x with velocities v (N, D).

    held (N,): never moves. pairs (E, 2) are joined by springs and dampers, rods (R,) are the numbers of those pairs
    that keep their length. touching (C, 2) are pairs that collide below the sum of their radii: a spring and a damper,
    contact (2,).
    """
    particles, axes = x.shape
    a[:] = 0.0
    for e in range(len(pairs)):
        pull(x, v, pairs[e, 0], pairs[e, 1], stiffness[e], damping[e], rest[e], False, a)
    for c in range(len(touching)):
        i, j = touching[c]
        pull(x, v, i, j, contact[0], contact[1], radius[i] + radius[j], True, a)
    for i in range(particles):
        for axis in range(axes):
            a[i, axis] = 0.0 if held[i] else a[i, axis] / mass[i] + gravity[axis]
    if len(rods) > 0:
        hold(x, v, held, mass, rest, pairs, rods, a)


@compiled
def pull(x, v, i, j, stiffness, damping, rest, pushes_only, force):  # type: ignore[no-untyped-def]
    """Adds the force of one spring and damper between particles i and j (eqs 3 and 5)."""
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


@compiled
def hold(x, v, held, mass, rest, pairs, rods, a):  # type: ignore[no-untyped-def]
    """Adds what rods pull, so that they keep their lengths: Lagrange's multipliers, found by elimination.

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
            gram[r, other] = coupling(x, held, mass, i, j, pairs[rods[other], 0], pairs[rods[other], 1])
    eliminate(gram)
    for r in range(count):
        i, j = pairs[rods[r]]
        for axis in range(axes):
            push = gram[r, count] * (x[j, axis] - x[i, axis])
            if not held[i]:
                a[i, axis] += push / mass[i]
            if not held[j]:
                a[j, axis] -= push / mass[j]


@compiled
def coupling(x, held, mass, i, j, p, q):  # type: ignore[no-untyped-def]
    """How much a unit tension in rod p-q shortens rod i-j, per time squared."""
    inverse = x[0, 0] * 0.0
    if i == p and not held[i]:
        inverse += 1 / mass[i]
    if i == q and not held[i]:
        inverse -= 1 / mass[i]
    if j == q and not held[j]:
        inverse += 1 / mass[j]
    if j == p and not held[j]:
        inverse -= 1 / mass[j]
    along = x[0, 0] * 0.0
    for axis in range(x.shape[1]):
        along += (x[j, axis] - x[i, axis]) * (x[q, axis] - x[p, axis])
    return inverse * along


@compiled
def eliminate(system):  # type: ignore[no-untyped-def]
    """Solves (R, R + Q) equations of a positive definite matrix in place; the last Q columns become the solutions.

    A rod that others make superfluous carries nothing.
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
