"""Motions of the mass-spring-damper model with their tangents: where a stretch ends and how that hangs on every number.

A step of Runge-Kutta is differentiated as it is taken (internal differentiation, Bock 1983,
doi:10.1007/978-1-4684-3324-1_15), so that slopes are those of the steps, exact to rounding. Tangents are arrays
(N, D, M) by M inputs, the innermost loops running over inputs. What the forces are stands in `models.physics.springs.spring_kernels`;
a test holds these slopes to its complex step.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.springs.spring_kernels import BAUMGARTE, accelerate, coupling, eliminate


@compiled
def flows(starts, spans, steps, tableau, shares, held, theta, pairs, rods, touching, inputs, ends, slopes):  # type: ignore[no-untyped-def]
    """Ends (K, 2, N, D) of K stretches that begin at `starts` and last `spans` (K,), and their slopes (K, 2 N D, M).

    inputs (M,): by which numbers; below 2 N D a number of the start, from there on one of theta (`Springs.numbers`).
    """
    particles, axes = starts.shape[2:]
    count, half = len(inputs), particles * axes
    sets = np.full(len(theta), -1)
    for m in range(count):
        if inputs[m] >= 2 * half:
            sets[inputs[m] - 2 * half] = m
    lean = np.empty((2, half, count))
    for k in range(len(starts)):
        ends[k] = starts[k]
        lean[:] = 0.0
        for m in range(count):
            if inputs[m] < 2 * half:
                lean[inputs[m] // half, inputs[m] % half, m] = 1.0
        advance(ends[k], lean, spans[k] / steps[k], steps[k], tableau, shares, held, theta, pairs, rods, touching, sets)
        slopes[k] = lean.reshape(2 * half, count)


@compiled
def advance(state, lean, dt, steps, tableau, shares, held, theta, pairs, rods, touching, sets):  # type: ignore[no-untyped-def]
    """Moves a state (2, N, D) and its tangents (2, N D, M) on by `steps` explicit Runge-Kutta steps of dt, in place."""
    particles, axes = state.shape[1:]
    stages, half, count = len(shares), particles * axes, lean.shape[2]
    rates = np.zeros((stages, 2, particles, axes))
    leans = np.zeros((stages, 2, half, count))
    at, off = np.zeros_like(state), np.zeros_like(lean)
    for _ in range(steps):
        for s in range(stages):
            at[:], off[:] = state, lean
            for earlier in range(s):
                weight = dt * tableau[s, earlier]
                if weight != 0.0:
                    add(at.reshape(-1), weight, rates[earlier].reshape(-1))
                    add(off.reshape(-1), weight, leans[earlier].reshape(-1))
            rates[s, 0], leans[s, 0] = at[1], off[1]
            bend(at, off, held, theta, pairs, rods, touching, sets, rates[s, 1], leans[s, 1])
        for s in range(stages):
            add(state.reshape(-1), dt * shares[s], rates[s].reshape(-1))
            add(lean.reshape(-1), dt * shares[s], leans[s].reshape(-1))


@compiled
def add(to, weight, what):  # type: ignore[no-untyped-def]
    """to += weight what, flat."""
    for k in range(len(to)):
        to[k] += weight * what[k]


@compiled
def bend(at, off, held, theta, pairs, rods, touching, sets, a, leans):  # type: ignore[no-untyped-def]
    """Writes accelerations a (N, D) at a state (2, N, D) and their tangents (N D, M); sets: input by number of theta,
    -1 where it is none."""
    particles, axes = a.shape
    edges, count = len(pairs), leans.shape[1]
    x, v = at
    mass, stiffness = theta[:particles], theta[particles : particles + edges]
    damping, rest = (
        theta[particles + edges : particles + 2 * edges],
        theta[particles + 2 * edges : particles + 3 * edges],
    )
    after = particles + 3 * edges
    gravity, radius = theta[after : after + axes], theta[after + axes : after + axes + particles]
    contact = theta[after + axes + particles :]
    none = rods[:0]
    accelerate(x, v, held, mass, stiffness, damping, rest, gravity, radius, contact, pairs, none, touching, a)
    if count > 0:
        leans[:] = 0.0
        for e in range(edges):
            if stiffness[e] != 0.0 or damping[e] != 0.0 or sets[particles + e] >= 0 or sets[particles + edges + e] >= 0:
                tug(
                    x,
                    v,
                    off,
                    pairs[e, 0],
                    pairs[e, 1],
                    stiffness[e],
                    damping[e],
                    rest[e],
                    False,
                    sets[particles + e],
                    sets[particles + edges + e],
                    sets[particles + 2 * edges + e],
                    -1,
                    leans,
                )
        spring, damper = sets[after + axes + particles], sets[after + axes + particles + 1]
        for c in range(len(touching)):
            i, j = touching[c]
            tug(
                x,
                v,
                off,
                i,
                j,
                contact[0],
                contact[1],
                radius[i] + radius[j],
                True,
                spring,
                damper,
                sets[after + axes + i],
                sets[after + axes + j],
                leans,
            )
        per_mass(a, held, mass, gravity, sets[:particles], sets[after : after + axes], leans)
    if len(rods) > 0:
        hold(x, v, off, held, mass, rest, pairs, rods, sets[:particles], sets[particles + 2 * edges : after], a, leans)


@compiled
def tug(x, v, off, i, j, stiffness, damping, rest, pushes_only, by_k, by_c, by_rest, by_other, leans):  # type: ignore[no-untyped-def]
    """Adds the tangents of the force of one spring and damper (Chen 2022, eqs 3 and 5); by_...: its numbers' inputs."""
    axes, count = x.shape[1], leans.shape[1]
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
        here, there, slow, fast = off[0, p], off[0, q], off[1, p], off[1, q]
        for m in range(count):
            more[m] += lengthened * (there[m] - here[m]) + rubbed * (fast[m] - slow[m])
    for axis in range(axes):
        p, q, d = i * axes + axis, j * axes + axis, x[j, axis] - x[i, axis]
        here, there, one, other = off[0, p], off[0, q], leans[p], leans[q]
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
                leans[p, m] += slope * d
                leans[q, m] -= slope * d


@compiled
def per_mass(a, held, mass, gravity, by_mass, by_gravity, leans):  # type: ignore[no-untyped-def]
    """Makes tangents of forces those of accelerations."""
    particles, axes = a.shape
    for i in range(particles):
        for axis in range(axes):
            row = leans[i * axes + axis]
            if held[i]:
                row[:] = 0.0
                continue
            row /= mass[i]
            if by_mass[i] >= 0:
                row[by_mass[i]] -= (a[i, axis] - gravity[axis]) / mass[i]
            if by_gravity[axis] >= 0:
                row[by_gravity[axis]] += 1.0


@compiled
def hold(x, v, off, held, mass, rest, pairs, rods, by_mass, by_rest, a, leans):  # type: ignore[no-untyped-def]
    """Adds to a and to its tangents what rods pull: `models.physics.springs.spring_kernels.hold`, differentiated."""
    count, axes, wide = len(rods), x.shape[1], leans.shape[1]
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
                dd, dw = off[0, q, m] - off[0, p, m], off[1, q, m] - off[1, p, m]
                pulls[r, count + m] += (
                    2 * w * dw
                    + dd * pull
                    + d * (leans[q, m] - leans[p, m])
                    + 2 * BAUMGARTE * (dd * w + d * dw)
                    + BAUMGARTE * BAUMGARTE * d * dd
                )
        if by_rest[rods[r]] >= 0:
            pulls[r, count + by_rest[rods[r]]] -= BAUMGARTE * BAUMGARTE * length
        system[r, count] = rate + 2 * BAUMGARTE * speed + 0.5 * BAUMGARTE * BAUMGARTE * off_length
        for other in range(count):
            g, h = pairs[rods[other]]
            system[r, other] = pulls[r, other] = coupling(x, held, mass, i, j, g, h)
    eliminate(system)
    if wide > 0:
        for r in range(count):
            for other in range(count):
                loosen(
                    x,
                    off,
                    held,
                    mass,
                    pairs[rods[r]],
                    pairs[rods[other]],
                    by_mass,
                    system[other, count],
                    pulls[r, count:],
                )
        eliminate(pulls)
    for r in range(count):
        haul(x, off, held, mass, pairs[rods[r]], by_mass, system[r, count], pulls[r, count:], a, leans)


@compiled
def shared(held, mass, rod, other):  # type: ignore[no-untyped-def]
    """One over mass at both ends of a rod where the other rod shares them, with the sign of what it pulls there."""
    i, j = rod
    p, q = other
    at_i = at_j = 0.0
    if not held[i]:
        at_i = ((1.0 if i == p else 0.0) - (1.0 if i == q else 0.0)) / mass[i]
    if not held[j]:
        at_j = ((1.0 if j == q else 0.0) - (1.0 if j == p else 0.0)) / mass[j]
    return at_i, at_j


@compiled
def loosen(x, off, held, mass, rod, other, by_mass, pull, row):  # type: ignore[no-untyped-def]
    """Takes from a row (M,) how the coupling of two rods changes, times what the other one pulls."""
    axes = x.shape[1]
    at_i, at_j = shared(held, mass, rod, other)
    i, j = rod
    p, q = other
    if at_i == 0.0 and at_j == 0.0:
        return
    along = 0.0
    for axis in range(axes):
        d, f = x[j, axis] - x[i, axis], x[q, axis] - x[p, axis]
        along += d * f
        for m in range(len(row)):
            dd = off[0, j * axes + axis, m] - off[0, i * axes + axis, m]
            df = off[0, q * axes + axis, m] - off[0, p * axes + axis, m]
            row[m] -= pull * (at_i + at_j) * (dd * f + d * df)
    if by_mass[i] >= 0:
        row[by_mass[i]] += pull * at_i / mass[i] * along
    if by_mass[j] >= 0:
        row[by_mass[j]] += pull * at_j / mass[j] * along


@compiled
def haul(x, off, held, mass, rod, by_mass, pull, pulls, a, leans):  # type: ignore[no-untyped-def]
    """Adds one rod's pull to the accelerations of its ends, and to their tangents."""
    axes = x.shape[1]
    i, j = rod
    for end, sign in ((i, 1.0), (j, -1.0)):
        if held[end]:
            continue
        for axis in range(axes):
            d, row = x[j, axis] - x[i, axis], end * axes + axis
            a[end, axis] += sign * pull * d / mass[end]
            for m in range(len(pulls)):
                dd = off[0, j * axes + axis, m] - off[0, i * axes + axis, m]
                leans[row, m] += sign * (pulls[m] * d + pull * dd) / mass[end]
            if by_mass[end] >= 0:
                leans[row, by_mass[end]] -= sign * pull * d / mass[end] ** 2
