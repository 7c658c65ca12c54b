"""Motion of rigid bodies in the plane: small steps, and impulses at contacts that are solved one after the other.

Sequential impulses start from those of the last step (Catto 2006, "Fast and simple physics using sequential impulses",
Game Developers Conference): restitution of the closing speed before the step, Coulomb friction, and overlap that is
removed by a velocity that moves bodies but is discarded after the step.

Bodies are convex polygons and discs; boundaries are straight. A body has V corners (`count` of them, the rest padding)
in the frame of its centre, ordered so that x turns towards y; one corner with a radius is a disc. A contact is a row of
`places` (C, 5): normal (from the first body to the second), point, gap (negative where they overlap); and of `owners`
(C, 3): first and second body (boundaries are numbered after the bodies), and a key of the corners that meet, which
identifies the same contact in the next step. Lengths are in the unit of the caller. Separating axes and clipping:
Ericson, Real-Time Collision Detection, 2005, sections 5.2 and 5.4.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel

# Most passes over all contacts of a step.
SOLVER_PASSES = 12
# Part of the excess overlap of bodies that is removed in one step.
OVERLAP_SHARE = 0.15


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
    _fill_face_normals(corners, count, normals)
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
            _place_bodies(q, corners, normals, count, placed, placed_normals)
            contact_count = _find_contacts(q, placed, placed_normals, count, radius, reach, planes, places, owners)
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

    work (C, 8) receives the lever arms of both bodies (4), the inverse masses for impulses along and across the normal,
    the separation speed that restitution asks for, and the speed that removes overlap.
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


# Two convex bodies in the plane rest on each other on two points.
MOST_CONTACTS_PER_PAIR = 2


@compile_kernel
def _fill_face_normals(corners, count, normals):  # type: ignore[no-untyped-def]
    """Write outward unit normals (B, V, 2) of the faces from each corner (B, V, 2) to the next."""
    for b in range(len(count)):
        for k in range(count[b] if count[b] > 1 else 0):
            following = k + 1 if k + 1 < count[b] else 0
            dx, dy = corners[b, following, 0] - corners[b, k, 0], corners[b, following, 1] - corners[b, k, 1]
            length = np.hypot(dx, dy)
            normals[b, k, 0], normals[b, k, 1] = dy / length, -dx / length


@compile_kernel
def _place_bodies(q, corners, normals, count, world, placed_normals):  # type: ignore[no-untyped-def]
    """Write corners and face normals of bodies at q (B, 3) as world and placed_normals (B, V, 2)."""
    for b in range(len(q)):
        cos, sin = np.cos(q[b, 2]), np.sin(q[b, 2])
        for k in range(count[b]):
            x, y = corners[b, k, 0], corners[b, k, 1]
            world[b, k, 0] = q[b, 0] + cos * x - sin * y
            world[b, k, 1] = q[b, 1] + sin * x + cos * y
            x, y = normals[b, k, 0], normals[b, k, 1]
            placed_normals[b, k, 0], placed_normals[b, k, 1] = cos * x - sin * y, sin * x + cos * y


@compile_kernel
def _find_contacts(q, world, normals, count, radius, reach, planes, places, owners):  # type: ignore[no-untyped-def]
    """Write all contacts of bodies that overlap; return their number.

    q (B, 3) places and angles; world and normals (B, V, 2) corners and face normals in place; radius (B,) of discs;
    reach (B,) radius of the circle around each body; planes (W, 3) inward normal and offset of the boundaries.
    """
    bodies, contact_count, most = len(q), 0, len(places) - 2 * MOST_CONTACTS_PER_PAIR
    for i in range(bodies):
        for w in range(len(planes)):
            nx, ny, offset = planes[w]
            if q[i, 0] * nx + q[i, 1] * ny - offset < reach[i] and contact_count < most:
                contact_count = _find_plane_contacts(
                    world[i], count[i], radius[i], planes[w], i, bodies + w, places, owners, contact_count
                )
        for j in range(i + 1, bodies):
            dx, dy, near = q[j, 0] - q[i, 0], q[j, 1] - q[i, 1], reach[i] + reach[j]
            if dx * dx + dy * dy < near * near and contact_count < most:
                contact_count = _find_pair_contacts(world, normals, count, radius, i, j, places, owners, contact_count)
    return contact_count


@compile_kernel
def _record_contact(nx, ny, x, y, gap, first, second, key, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write one contact; return the number of contacts."""
    places[contact_count, 0], places[contact_count, 1] = nx, ny
    places[contact_count, 2], places[contact_count, 3], places[contact_count, 4] = x, y, gap
    owners[contact_count, 0], owners[contact_count, 1], owners[contact_count, 2] = first, second, key
    return contact_count + 1


@compile_kernel
def _find_plane_contacts(corners, count, radius, plane, body, number, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write the two deepest corners of a body below a boundary; return the number of contacts."""
    nx, ny, offset = plane
    first = second = -1
    deepest = deep = radius
    for k in range(count):
        height = corners[k, 0] * nx + corners[k, 1] * ny - offset
        if height < deepest:
            second, deep = first, deepest
            first, deepest = k, height
        elif height < deep:
            second, deep = k, height
    for k, height in ((first, deepest), (second, deep)):
        if k >= 0:
            x, y = corners[k, 0] - radius * nx, corners[k, 1] - radius * ny
            contact_count = _record_contact(
                -nx, -ny, x, y, height - radius, body, number, k, places, owners, contact_count
            )
    return contact_count


@compile_kernel
def _find_pair_contacts(world, normals, count, radius, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write the contacts of bodies i < j; return the number of contacts."""
    if count[i] > 1 and count[j] > 1:
        return _find_polygon_contacts(
            world[i], normals[i], count[i], world[j], normals[j], count[j], i, j, places, owners, contact_count
        )
    if count[i] > 1:
        return _find_disc_contact(
            world[j, 0], radius[j], world[i], normals[i], count[i], 1.0, i, j, places, owners, contact_count
        )
    if count[j] > 1:
        return _find_disc_contact(
            world[i, 0], radius[i], world[j], normals[j], count[j], -1.0, i, j, places, owners, contact_count
        )
    dx, dy = world[j, 0, 0] - world[i, 0, 0], world[j, 0, 1] - world[i, 0, 1]
    apart = np.hypot(dx, dy)
    gap = apart - radius[i] - radius[j]
    if gap >= 0 or apart == 0:
        return contact_count
    nx, ny = dx / apart, dy / apart
    x, y = world[i, 0, 0] + radius[i] * nx, world[i, 0, 1] + radius[i] * ny
    return _record_contact(nx, ny, x, y, gap, i, j, 0, places, owners, contact_count)


@compile_kernel
def _find_separating_face(a, normals, na, b, nb):  # type: ignore[no-untyped-def]
    """Find the face of polygon a that polygon b is farthest beyond.

    Returns the distance and the face. The search stops at the first face with b beyond it.
    """
    best, which = -np.inf, 0
    for k in range(na):
        nx, ny = normals[k, 0], normals[k, 1]
        least = np.inf
        for m in range(nb):
            least = min(least, b[m, 0] * nx + b[m, 1] * ny)
        least -= a[k, 0] * nx + a[k, 1] * ny
        if least > best:
            best, which = least, k
            if best >= 0:
                break
    return best, which


@compile_kernel
def _find_polygon_contacts(a, normals_a, na, b, normals_b, nb, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write up to two contacts of overlapping polygons; return the number of contacts."""
    gap_a, face_a = _find_separating_face(a, normals_a, na, b, nb)
    if gap_a >= 0:
        return contact_count
    gap_b, face_b = _find_separating_face(b, normals_b, nb, a, na)
    if gap_b >= 0:
        return contact_count
    # a little in favour of the first, so that equal faces do not change roles from step to step
    if gap_b > 0.95 * gap_a + 1e-3 * abs(gap_a):
        return _clip_faces(b, normals_b, nb, face_b, a, normals_a, na, -1.0, i, j, places, owners, contact_count)
    return _clip_faces(a, normals_a, na, face_a, b, normals_b, nb, 1.0, i, j, places, owners, contact_count)


@compile_kernel
def _clip_faces(a, normals_a, na, k, b, normals_b, nb, sense, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write the contacts of face k of polygon a with the face of b that faces it; return the number of contacts."""
    nx, ny = normals_a[k]
    facing, m = np.inf, 0
    for n in range(nb):
        mx, my = normals_b[n]
        if mx * nx + my * ny < facing:
            facing, m = mx * nx + my * ny, n
    end = m + 1 if m + 1 < nb else 0
    following = k + 1 if k + 1 < na else 0
    tx, ty = -ny, nx
    low = a[k, 0] * tx + a[k, 1] * ty
    high = a[following, 0] * tx + a[following, 1] * ty
    s, e = b[m, 0] * tx + b[m, 1] * ty, b[end, 0] * tx + b[end, 1] * ty
    for which, here in ((m, s), (end, e)):
        at = min(max(here, low), high)
        share = 0.0 if e == s else min(max((at - s) / (e - s), 0.0), 1.0)
        x, y = b[m, 0] + share * (b[end, 0] - b[m, 0]), b[m, 1] + share * (b[end, 1] - b[m, 1])
        gap = (x - a[k, 0]) * nx + (y - a[k, 1]) * ny
        if gap < 0:
            key = (64 * k + which) * 2 + (1 if sense < 0 else 0)
            contact_count = _record_contact(sense * nx, sense * ny, x, y, gap, i, j, key, places, owners, contact_count)
    return contact_count


@compile_kernel
def _find_disc_contact(centre, radius, corners, normals, count, sense, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write the contact of a disc with the nearest point of a polygon; return the number of contacts.

    `sense` is 1 where the polygon is the first body, otherwise -1.
    """
    best, k = -np.inf, 0
    for m in range(count):
        nx, ny = normals[m]
        off = (centre[0] - corners[m, 0]) * nx + (centre[1] - corners[m, 1]) * ny
        if off > best:
            best, k = off, m
    if best >= radius:
        return contact_count
    nx, ny = normals[k]
    following = k + 1 if k + 1 < count else 0
    along = (centre[0] - corners[k, 0]) * -ny + (centre[1] - corners[k, 1]) * nx
    length = (corners[following, 0] - corners[k, 0]) * -ny + (corners[following, 1] - corners[k, 1]) * nx
    x, y, gap = centre[0] - best * nx, centre[1] - best * ny, best - radius
    if best > 0 and (along < 0 or along > length):
        corner = k if along < 0 else following
        x, y = corners[corner, 0], corners[corner, 1]
        apart = np.hypot(centre[0] - x, centre[1] - y)
        nx, ny, gap = (centre[0] - x) / apart, (centre[1] - y) / apart, apart - radius
    if gap >= 0:
        return contact_count
    return _record_contact(sense * nx, sense * ny, x, y, gap, i, j, k, places, owners, contact_count)
