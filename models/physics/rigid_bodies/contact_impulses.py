"""Motion of rigid bodies in the plane: small steps, and impulses at contacts that are solved one after the other.

Sequential impulses start from those of the last step (Catto 2006, "Fast and simple physics using sequential impulses",
Game Developers Conference): restitution of the closing speed before the step, Coulomb friction, and overlap that is
removed by a velocity that moves bodies but is discarded after the step.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.rigid_bodies.collision_detection import fill_face_normals, find_contacts, place_bodies

SOLVER_PASSES = 12
"""Most passes over all contacts of a step."""
OVERLAP_SHARE = 0.15
"""Part of the excess overlap of bodies that is removed in one step."""


@compile_kernel
def simulate_bodies(  # type: ignore[no-untyped-def]
    q, v, corners, count, radius, reach, inverse_inertia, planes, world, h, steps, samples, last_owners, last_impulses
):
    """Simulate bodies for the longest of several numbers of steps.

    Args:
        q: (B, 3) places and angles (rad), changed in place.
        v: (B, 3) their velocities, changed in place.
        corners: (B, V, 2) in the frame of each body.
        count: (B,) corners of each body.
        radius: (B,) of discs.
        reach: (B,) radius of the circle around each body.
        inverse_inertia: (B, 2) one over mass and over moment of inertia.
        planes: (W, 3) inward normal and offset of the boundaries.
        world: (7,) gravity x, gravity y, friction, restitution, drag (1/s), overlap that stays so that lasting contacts
            are found again, and how far off a body may be at the end because no more passes were made.
        h: s of one step.
        steps: (M,) numbers of steps, ascending.
        samples: (M, B, 3) receives places after these numbers of steps.
        last_owners: (C, 3) contacts of the step before, changed in place; the first row begins with -1 if there are
            none.
        last_impulses: (C, 2) their impulses, changed in place.
    """
    bodies, most = len(q), len(last_impulses)
    placed, normals, placed_normals = np.zeros_like(corners), np.zeros_like(corners), np.zeros_like(corners)
    fill_face_normals(corners, count, normals)
    places, owners = np.empty((most, 5)), np.zeros((most, 3), np.int64)
    impulses, last_count = np.zeros((most, 2)), 0
    while last_count < most and last_owners[last_count, 0] >= 0:
        last_count += 1
    first_of_pair = np.full((bodies, bodies + len(planes)), -1)
    work, bias, done = np.empty((most, 8)), np.zeros((bodies, 3)), 0
    decay = np.exp(-world[4] * h)
    still = world[6] / (h * steps[-1])
    for number in range(len(steps)):
        while done < steps[number]:
            for b in range(bodies):
                pull = h if inverse_inertia[b, 0] > 0 else 0.0
                v[b, 0] = v[b, 0] * decay + world[0] * pull
                v[b, 1] = v[b, 1] * decay + world[1] * pull
                v[b, 2] *= decay
            place_bodies(q, corners, normals, count, placed, placed_normals)
            contact_count = find_contacts(q, placed, placed_normals, count, radius, reach, planes, places, owners)
            recall_impulses(owners, contact_count, last_owners, last_impulses, last_count, first_of_pair, impulses)
            prepare_contacts(q, v, places, owners, contact_count, inverse_inertia, world, h, work, impulses)
            bias[:] = 0.0
            for _ in range(SOLVER_PASSES):
                changed = solve_contacts(
                    v, bias, places, owners, contact_count, inverse_inertia, world[2], work, impulses
                )
                if changed < still:
                    break
            for b in range(bodies):
                for axis in range(3):
                    q[b, axis] += h * (v[b, axis] + bias[b, axis])
            last_count = contact_count
            last_owners[:contact_count], last_impulses[:contact_count] = (
                owners[:contact_count],
                impulses[:contact_count],
            )
            last_owners[contact_count:, 0] = -1
            done += 1
        samples[number] = q


@compile_kernel
def recall_impulses(owners, contact_count, last_owners, last_impulses, last_count, first_of_pair, impulses):  # type: ignore[no-untyped-def]
    """Write the impulse of each contact in the step before, 0 for new contacts."""
    for c in range(last_count):
        if first_of_pair[last_owners[c, 0], last_owners[c, 1]] < 0:
            first_of_pair[last_owners[c, 0], last_owners[c, 1]] = c
    for c in range(contact_count):
        impulses[c] = 0.0
        old = first_of_pair[owners[c, 0], owners[c, 1]]
        while 0 <= old < last_count and last_owners[old, 0] == owners[c, 0] and last_owners[old, 1] == owners[c, 1]:
            if last_owners[old, 2] == owners[c, 2]:
                impulses[c] = last_impulses[old]
                break
            old += 1
    for c in range(last_count):
        first_of_pair[last_owners[c, 0], last_owners[c, 1]] = -1


@compile_kernel
def lever_arms(q, places, owners, c):  # type: ignore[no-untyped-def]
    """Return the vectors from the centres of both bodies to contact c."""
    i, j = owners[c, 0], owners[c, 1]
    ax, ay = places[c, 2] - q[i, 0], places[c, 3] - q[i, 1]
    if j >= len(q):
        return ax, ay, 0.0, 0.0
    return ax, ay, places[c, 2] - q[j, 0], places[c, 3] - q[j, 1]


@compile_kernel
def relative_velocity(v, i, j, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Return the velocity at a contact of the second body relative to the first."""
    x, y = -(v[i, 0] - v[i, 2] * ay), -(v[i, 1] + v[i, 2] * ax)
    if j < len(v):
        x += v[j, 0] - v[j, 2] * by
        y += v[j, 1] + v[j, 2] * bx
    return x, y


@compile_kernel
def apply_impulse(v, inverse_inertia, i, j, ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Apply the impulse (px, py) at a contact to the second body, and its opposite to the first."""
    v[i, 0] -= inverse_inertia[i, 0] * px
    v[i, 1] -= inverse_inertia[i, 0] * py
    v[i, 2] -= inverse_inertia[i, 1] * (ax * py - ay * px)
    if j < len(v):
        v[j, 0] += inverse_inertia[j, 0] * px
        v[j, 1] += inverse_inertia[j, 0] * py
        v[j, 2] += inverse_inertia[j, 1] * (bx * py - by * px)


@compile_kernel
def prepare_contacts(q, v, places, owners, contact_count, inverse_inertia, world, h, work, impulses):  # type: ignore[no-untyped-def]
    """Prepare the passes over contacts, and apply the impulses of the step before.

    work (C, 8) receives lever arms (4), inverse masses along and across, wanted separation speed, and speed that
    removes overlap.
    """
    for c in range(contact_count):
        i, j = owners[c, 0], owners[c, 1]
        nx, ny, gap = places[c, 0], places[c, 1], places[c, 4]
        ax, ay, bx, by = lever_arms(q, places, owners, c)
        mass, turn_i, turn_j = inverse_inertia[i, 0], inverse_inertia[i, 1], 0.0
        if j < len(q):
            mass, turn_j = mass + inverse_inertia[j, 0], inverse_inertia[j, 1]
        normal = mass + turn_i * (ax * ny - ay * nx) ** 2 + turn_j * (bx * ny - by * nx) ** 2
        across = mass + turn_i * (ax * nx + ay * ny) ** 2 + turn_j * (bx * nx + by * ny) ** 2
        x, y = relative_velocity(v, i, j, ax, ay, bx, by)
        work[c, 0], work[c, 1], work[c, 2], work[c, 3] = ax, ay, bx, by
        work[c, 4], work[c, 5] = normal, across
        work[c, 6] = -world[3] * min(x * nx + y * ny, 0.0)
        work[c, 7] = OVERLAP_SHARE * max(-gap - world[5], 0.0) / h
    for c in range(contact_count):
        nx, ny = places[c, 0], places[c, 1]
        along, across = impulses[c]
        ax, ay, bx, by = work[c, 0], work[c, 1], work[c, 2], work[c, 3]
        px, py = along * nx - across * ny, along * ny + across * nx
        apply_impulse(v, inverse_inertia, owners[c, 0], owners[c, 1], ax, ay, bx, by, px, py)


@compile_kernel
def solve_contacts(v, bias, places, owners, contact_count, inverse_inertia, friction, work, impulses):  # type: ignore[no-untyped-def]
    """Make one pass over all contacts: bodies do not approach, and friction stays within Coulomb's cone.

    Returns the greatest change of the velocity at any contact.
    """
    changed = 0.0
    for c in range(contact_count):
        i, j = owners[c, 0], owners[c, 1]
        nx, ny = places[c, 0], places[c, 1]
        ax, ay, bx, by = work[c, 0], work[c, 1], work[c, 2], work[c, 3]
        if work[c, 7] > 0:
            x, y = relative_velocity(bias, i, j, ax, ay, bx, by)
            lift = max((work[c, 7] - (x * nx + y * ny)) / work[c, 4], 0.0)
            apply_impulse(bias, inverse_inertia, i, j, ax, ay, bx, by, lift * nx, lift * ny)
            changed = max(changed, lift * work[c, 4])
        x, y = relative_velocity(v, i, j, ax, ay, bx, by)
        along = max(impulses[c, 0] + (work[c, 6] - (x * nx + y * ny)) / work[c, 4], 0.0)
        across = impulses[c, 1] - (y * nx - x * ny) / work[c, 5]
        across = min(max(across, -friction * along), friction * along)
        more, rub = along - impulses[c, 0], across - impulses[c, 1]
        impulses[c, 0], impulses[c, 1] = along, across
        apply_impulse(v, inverse_inertia, i, j, ax, ay, bx, by, more * nx - rub * ny, more * ny + rub * nx)
        changed = max(changed, abs(more) * work[c, 4], abs(rub) * work[c, 5])
    return changed
