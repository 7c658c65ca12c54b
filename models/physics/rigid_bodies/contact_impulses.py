"""How rigid bodies move and push each other: small steps, impulses at contacts found one after the other.

Sequential impulses with what the last step found as the first guess (Catto 2006, "Fast and simple physics using
sequential impulses", Game Developers Conference): restitution of the closing speed before the step, Coulomb friction,
and overlap taken back by a velocity that moves bodies but is forgotten after the step.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.rigid_bodies.collision_detection import contacts, faces, spread

SOLVER_PASSES = 12
"""over all contacts of a step, at most."""
OVERLAP_SHARE = 0.15
"""of what bodies overlap too much is taken back in one step."""


@compiled
def march(q, v, corners, count, radius, reach, lightness, planes, laws, h, steps, samples, before, known):  # type: ignore[no-untyped-def]
    """Moves bodies q, v (B, 3) on by the longest of `steps` (M,) steps of h s; samples (M, B, 3) places on the way.

    lightness (B, 2): one over mass and over moment of inertia. planes (W, 3). laws: gravity x, y, friction,
    restitution, drag (1/s), overlap that stays so that lasting contacts are found again, and how far off a body may be
    in the end because no more passes were made. before (C, 3), known (C, 2): the contacts of the step before and what
    they pushed, worked on in place; a first row of -1 where there is none.
    """
    bodies, most = len(q), len(known)
    world, normals, turned = np.zeros_like(corners), np.zeros_like(corners), np.zeros_like(corners)
    faces(corners, count, normals)
    places, owners = np.empty((most, 5)), np.zeros((most, 3), np.int64)
    kept, last = np.zeros((most, 2)), 0
    while last < most and before[last, 0] >= 0:
        last += 1
    seek = np.full((bodies, bodies + len(planes)), -1)
    work, bias, done = np.empty((most, 8)), np.zeros((bodies, 3)), 0
    decay = np.exp(-laws[4] * h)
    still = laws[6] / (h * steps[-1])
    for number in range(len(steps)):
        while done < steps[number]:
            for b in range(bodies):
                pull = h if lightness[b, 0] > 0 else 0.0
                v[b, 0] = v[b, 0] * decay + laws[0] * pull
                v[b, 1] = v[b, 1] * decay + laws[1] * pull
                v[b, 2] *= decay
            spread(q, corners, normals, count, world, turned)
            found = contacts(q, world, turned, count, radius, reach, planes, places, owners)
            recall(owners, found, before, known, last, seek, kept)
            prepare(q, v, places, owners, found, lightness, laws, h, work, kept)
            bias[:] = 0.0
            for _ in range(SOLVER_PASSES):
                changed = push(v, bias, places, owners, found, lightness, laws[2], work, kept)
                if changed < still:
                    break
            for b in range(bodies):
                for axis in range(3):
                    q[b, axis] += h * (v[b, axis] + bias[b, axis])
            last = found
            before[:found], known[:found] = owners[:found], kept[:found]
            before[found:, 0] = -1
            done += 1
        samples[number] = q


@compiled
def recall(owners, found, before, known, last, seek, kept):  # type: ignore[no-untyped-def]
    """Writes what each contact pushed in the step before, 0 where it is new."""
    for c in range(last):
        if seek[before[c, 0], before[c, 1]] < 0:
            seek[before[c, 0], before[c, 1]] = c
    for c in range(found):
        kept[c] = 0.0
        old = seek[owners[c, 0], owners[c, 1]]
        while 0 <= old < last and before[old, 0] == owners[c, 0] and before[old, 1] == owners[c, 1]:
            if before[old, 2] == owners[c, 2]:
                kept[c] = known[old]
                break
            old += 1
    for c in range(last):
        seek[before[c, 0], before[c, 1]] = -1


@compiled
def arms(q, places, owners, c):  # type: ignore[no-untyped-def]
    """Vectors from the centres of both bodies to the contact."""
    i, j = owners[c, 0], owners[c, 1]
    ax, ay = places[c, 2] - q[i, 0], places[c, 3] - q[i, 1]
    if j >= len(q):
        return ax, ay, 0.0, 0.0
    return ax, ay, places[c, 2] - q[j, 0], places[c, 3] - q[j, 1]


@compiled
def closing(v, i, j, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Velocity at the contact of the second body as seen from the first."""
    x, y = -(v[i, 0] - v[i, 2] * ay), -(v[i, 1] + v[i, 2] * ax)
    if j < len(v):
        x += v[j, 0] - v[j, 2] * by
        y += v[j, 1] + v[j, 2] * bx
    return x, y


@compiled
def give(v, lightness, i, j, ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Gives the second body the impulse (px, py) at the contact, and the first one the opposite."""
    v[i, 0] -= lightness[i, 0] * px
    v[i, 1] -= lightness[i, 0] * py
    v[i, 2] -= lightness[i, 1] * (ax * py - ay * px)
    if j < len(v):
        v[j, 0] += lightness[j, 0] * px
        v[j, 1] += lightness[j, 0] * py
        v[j, 2] += lightness[j, 1] * (bx * py - by * px)


@compiled
def prepare(q, v, places, owners, found, lightness, laws, h, work, kept):  # type: ignore[no-untyped-def]
    """Writes what the passes need of each contact (arms, masses along and across, speeds wanted), and pushes as the
    step before did."""
    for c in range(found):
        i, j = owners[c, 0], owners[c, 1]
        nx, ny, gap = places[c, 0], places[c, 1], places[c, 4]
        ax, ay, bx, by = arms(q, places, owners, c)
        mass, turn_i, turn_j = lightness[i, 0], lightness[i, 1], 0.0
        if j < len(q):
            mass, turn_j = mass + lightness[j, 0], lightness[j, 1]
        normal = mass + turn_i * (ax * ny - ay * nx) ** 2 + turn_j * (bx * ny - by * nx) ** 2
        across = mass + turn_i * (ax * nx + ay * ny) ** 2 + turn_j * (bx * nx + by * ny) ** 2
        x, y = closing(v, i, j, ax, ay, bx, by)
        work[c, 0], work[c, 1], work[c, 2], work[c, 3] = ax, ay, bx, by
        work[c, 4], work[c, 5] = normal, across
        work[c, 6] = -laws[3] * min(x * nx + y * ny, 0.0)
        work[c, 7] = OVERLAP_SHARE * max(-gap - laws[5], 0.0) / h
    for c in range(found):
        nx, ny = places[c, 0], places[c, 1]
        along, across = kept[c]
        ax, ay, bx, by = work[c, 0], work[c, 1], work[c, 2], work[c, 3]
        px, py = along * nx - across * ny, along * ny + across * nx
        give(v, lightness, owners[c, 0], owners[c, 1], ax, ay, bx, by, px, py)


@compiled
def push(v, bias, places, owners, found, lightness, friction, work, kept):  # type: ignore[no-untyped-def]
    """One pass over all contacts: bodies do not approach, and rub within Coulomb's cone. Says how much it changed the
    velocity at any contact at most."""
    changed = 0.0
    for c in range(found):
        i, j = owners[c, 0], owners[c, 1]
        nx, ny = places[c, 0], places[c, 1]
        ax, ay, bx, by = work[c, 0], work[c, 1], work[c, 2], work[c, 3]
        if work[c, 7] > 0:
            x, y = closing(bias, i, j, ax, ay, bx, by)
            lift = max((work[c, 7] - (x * nx + y * ny)) / work[c, 4], 0.0)
            give(bias, lightness, i, j, ax, ay, bx, by, lift * nx, lift * ny)
            changed = max(changed, lift * work[c, 4])
        x, y = closing(v, i, j, ax, ay, bx, by)
        along = max(kept[c, 0] + (work[c, 6] - (x * nx + y * ny)) / work[c, 4], 0.0)
        across = kept[c, 1] - (y * nx - x * ny) / work[c, 5]
        across = min(max(across, -friction * along), friction * along)
        more, rub = along - kept[c, 0], across - kept[c, 1]
        kept[c, 0], kept[c, 1] = along, across
        give(v, lightness, i, j, ax, ay, bx, by, more * nx - rub * ny, more * ny + rub * nx)
        changed = max(changed, abs(more) * work[c, 4], abs(rub) * work[c, 5])
    return changed
