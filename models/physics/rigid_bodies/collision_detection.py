"""Collision detection of rigid bodies in the plane.

Compiled kernels for convex polygons, discs and straight boundaries.

A body has V corners (`count` of them, the rest padding) in the frame of its centre, ordered so that x turns towards y;
one corner with a radius is a disc. A contact is a row of `places` (C, 5): normal (from the first body to the second),
point, gap (negative where they overlap); and of `owners` (C, 3): first and second body (boundaries are numbered after
the bodies), and a key of the corners that meet, which identifies the same contact in the next step. Lengths are in the
unit of the caller.
Separating axes and clipping: Ericson, Real-Time Collision Detection, 2005, sections 5.2 and 5.4.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel

MOST_CONTACTS_PER_PAIR = 2
"""Two convex bodies in the plane rest on each other on two points."""


@compile_kernel
def fill_face_normals(corners, count, normals):  # type: ignore[no-untyped-def]
    """Write outward unit normals (B, V, 2) of the faces from each corner (B, V, 2) to the next."""
    for b in range(len(count)):
        for k in range(count[b] if count[b] > 1 else 0):
            following = k + 1 if k + 1 < count[b] else 0
            dx, dy = corners[b, following, 0] - corners[b, k, 0], corners[b, following, 1] - corners[b, k, 1]
            length = np.hypot(dx, dy)
            normals[b, k, 0], normals[b, k, 1] = dy / length, -dx / length


@compile_kernel
def place_bodies(q, corners, normals, count, world, placed_normals):  # type: ignore[no-untyped-def]
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
def find_contacts(q, world, normals, count, radius, reach, planes, places, owners):  # type: ignore[no-untyped-def]
    """Write all contacts of bodies that overlap; return their number.

    q (B, 3) places and angles; world and normals (B, V, 2) corners and face normals in place; radius (B,) of discs;
    reach (B,) radius of the circle around each body; planes (W, 3) inward normal and offset of the boundaries.
    """
    bodies, contact_count, most = len(q), 0, len(places) - 2 * MOST_CONTACTS_PER_PAIR
    for i in range(bodies):
        for w in range(len(planes)):
            nx, ny, offset = planes[w]
            if q[i, 0] * nx + q[i, 1] * ny - offset < reach[i] and contact_count < most:
                contact_count = find_plane_contacts(
                    world[i], count[i], radius[i], planes[w], i, bodies + w, places, owners, contact_count
                )
        for j in range(i + 1, bodies):
            dx, dy, near = q[j, 0] - q[i, 0], q[j, 1] - q[i, 1], reach[i] + reach[j]
            if dx * dx + dy * dy < near * near and contact_count < most:
                contact_count = find_pair_contacts(world, normals, count, radius, i, j, places, owners, contact_count)
    return contact_count


@compile_kernel
def record_contact(nx, ny, x, y, gap, first, second, key, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write one contact; return the number of contacts."""
    places[contact_count, 0], places[contact_count, 1] = nx, ny
    places[contact_count, 2], places[contact_count, 3], places[contact_count, 4] = x, y, gap
    owners[contact_count, 0], owners[contact_count, 1], owners[contact_count, 2] = first, second, key
    return contact_count + 1


@compile_kernel
def find_plane_contacts(corners, count, radius, plane, body, number, places, owners, contact_count):  # type: ignore[no-untyped-def]
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
            contact_count = record_contact(
                -nx, -ny, x, y, height - radius, body, number, k, places, owners, contact_count
            )
    return contact_count


@compile_kernel
def find_pair_contacts(world, normals, count, radius, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write the contacts of bodies i < j; return the number of contacts."""
    if count[i] > 1 and count[j] > 1:
        return find_polygon_contacts(
            world[i], normals[i], count[i], world[j], normals[j], count[j], i, j, places, owners, contact_count
        )
    if count[i] > 1:
        return find_disc_contact(
            world[j, 0], radius[j], world[i], normals[i], count[i], 1.0, i, j, places, owners, contact_count
        )
    if count[j] > 1:
        return find_disc_contact(
            world[i, 0], radius[i], world[j], normals[j], count[j], -1.0, i, j, places, owners, contact_count
        )
    dx, dy = world[j, 0, 0] - world[i, 0, 0], world[j, 0, 1] - world[i, 0, 1]
    apart = np.hypot(dx, dy)
    gap = apart - radius[i] - radius[j]
    if gap >= 0 or apart == 0:
        return contact_count
    nx, ny = dx / apart, dy / apart
    x, y = world[i, 0, 0] + radius[i] * nx, world[i, 0, 1] + radius[i] * ny
    return record_contact(nx, ny, x, y, gap, i, j, 0, places, owners, contact_count)


@compile_kernel
def find_separating_face(a, normals, na, b, nb):  # type: ignore[no-untyped-def]
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
def find_polygon_contacts(a, normals_a, na, b, normals_b, nb, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
    """Write up to two contacts of overlapping polygons; return the number of contacts."""
    gap_a, face_a = find_separating_face(a, normals_a, na, b, nb)
    if gap_a >= 0:
        return contact_count
    gap_b, face_b = find_separating_face(b, normals_b, nb, a, na)
    if gap_b >= 0:
        return contact_count
    # a little in favour of the first, so that equal faces do not change roles from step to step
    if gap_b > 0.95 * gap_a + 1e-3 * abs(gap_a):
        return clip_faces(b, normals_b, nb, face_b, a, normals_a, na, -1.0, i, j, places, owners, contact_count)
    return clip_faces(a, normals_a, na, face_a, b, normals_b, nb, 1.0, i, j, places, owners, contact_count)


@compile_kernel
def clip_faces(a, normals_a, na, k, b, normals_b, nb, sense, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
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
            contact_count = record_contact(sense * nx, sense * ny, x, y, gap, i, j, key, places, owners, contact_count)
    return contact_count


@compile_kernel
def find_disc_contact(centre, radius, corners, normals, count, sense, i, j, places, owners, contact_count):  # type: ignore[no-untyped-def]
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
    return record_contact(sense * nx, sense * ny, x, y, gap, i, j, k, places, owners, contact_count)
