"""Parameters of a world of rigid bodies: gravity, friction, restitution, drag, boundaries; and initial guesses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.rigid_bodies.body_clusters import Bodies

# Inward normals of the boundaries that are searched.
BOUNDARY_NORMALS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Distance from the end of all motion on one side, over its extent, within which bodies may have touched a boundary.
BOUNDARY_DISTANCE = 0.02
# Share of gravity, and of strong accelerations, above which a push from a side indicates a boundary.
BOUNDARY_PUSH = 0.25
# Relative difference of the accelerations in two intervals of free flight.
MAX_FLIGHT_CHANGE = 0.05
# Pairs of intervals of free flight that determine gravity.
MIN_FLIGHTS = 3
# Samples from one to the next.
STRIDES = (1, 2, 3, 5)
# Pairs of intervals that are compared with each other.
MAX_FLIGHTS = 2000
# Standard deviations of a significant acceleration.
SIGNIFICANT_SIGMAS = 6.0
# Acceptable error of the final contacts, over a body's size.
REST_TOLERANCE = 1e-3
# Remaining overlap, over a body's size, by which lasting contacts are found again.
ALLOWED_OVERLAP = 1e-3


@dataclass(frozen=True, slots=True)
class RigidBodyWorld:
    """Parameters that hold for all bodies. Units of length and time are the caller's."""

    gravity: FloatArray
    """(2,)"""
    friction: float
    restitution: float
    drag: float
    """1/time: share of its velocity that a body loses."""
    radius: FloatArray
    """(B,) of discs, 0 for polygons."""
    density: float
    """Of discs, relative to that of polygons."""
    planes: FloatArray
    """(W, 3) inward normals and offsets of straight boundaries."""

    @property
    def search_key(self) -> tuple[float, ...]:
        """All parameters that are searched, as a dictionary key."""
        return (*self.gravity.tolist(), self.friction, self.restitution, self.drag, self.density, *self.radius.tolist())

    def inverse_masses(self, bodies: Bodies) -> FloatArray:
        """Compute the inverse mass and inverse moment of inertia (B, 2)."""
        discs = bodies.discs
        area = np.where(discs, np.pi * self.radius**2 * self.density, bodies.area)
        moment = np.where(discs, self.radius**2 / 2, bodies.moment)
        # bodies of median size have mass 1
        mass = area / np.median(area)
        return np.stack([1 / mass, 1 / (mass * moment)], axis=1)

    def kernel_parameters(self, bodies: Bodies) -> FloatArray:
        """Collect the parameters (7,) for `models.physics.rigid_bodies.contact_impulses`."""
        size = bodies.size if np.isfinite(bodies.size) else float(np.median(self.radius))
        return np.array(
            [*self.gravity, self.friction, self.restitution, self.drag, ALLOWED_OVERLAP * size, REST_TOLERANCE * size]
        )


def guess_worlds(bodies: Bodies, t: FloatArray, places: FloatArray, sigma: float) -> list[RigidBodyWorld]:
    """Guess worlds to start a search from.

    One has the observed gravity, one has none, because drag in a view from above looks like gravity.

    Args:
        bodies: Rigid bodies.
        t: (T,) s.
        places: (T, B, 3) observed poses.
        sigma: Standard deviation of the centres.

    Returns:
        One or two worlds.
    """
    radius = _estimate_radii(bodies, places)
    gravity_estimate = _estimate_gravity(t, places, sigma)
    return [
        RigidBodyWorld(gravity, 0.3, 0.2, 0.0, radius, 1.0, _find_boundaries(bodies, t, places, radius, gravity, sigma))
        for gravity in ([gravity_estimate, np.zeros(2)] if gravity_estimate.any() else [gravity_estimate])
    ]


def _estimate_gravity(t: FloatArray, places: FloatArray, sigma: float) -> FloatArray:
    """Estimate gravity from every sample, or from every few where noise hides it between neighbours."""
    for stride in STRIDES:
        acceleration = (
            _find_common_acceleration(t[::stride], places[::stride], sigma) if len(t) > 4 * stride else np.zeros(2)
        )
        if acceleration.any():
            return acceleration
    return np.zeros(2)


def _find_common_acceleration(t: FloatArray, places: FloatArray, sigma: float) -> FloatArray:
    """Find the acceleration of most bodies in two consecutive intervals: only gravity is so steady and common."""
    bend, error = _sample_accelerations(t, places), acceleration_error(t, sigma)
    middle = (bend[:-1] + bend[1:]) / 2
    size = np.linalg.norm(middle, axis=2)
    steady = (np.linalg.norm(np.diff(bend, axis=0), axis=2) < MAX_FLIGHT_CHANGE * size + error / SIGNIFICANT_SIGMAS) & (
        size > error
    )
    flights = middle[steady][:MAX_FLIGHTS]
    if len(flights) < MIN_FLIGHTS:
        return np.zeros(2)
    near = (
        np.linalg.norm(flights[:, None] - flights, axis=2)
        < MAX_FLIGHT_CHANGE * np.linalg.norm(flights, axis=1) + error / SIGNIFICANT_SIGMAS
    )
    chosen = near[:, int(np.argmax(near.sum(axis=0)))]
    if chosen.sum() < MIN_FLIGHTS:
        return np.zeros(2)
    return np.asarray(np.median(flights[chosen], axis=0), np.float64)


def _polygon_corners(bodies: Bodies, places: FloatArray) -> list[FloatArray]:
    """Compute the corners (T, n, 2) of every body."""
    cos, sin = np.cos(places[..., 2]), np.sin(places[..., 2])
    corners = []
    for b, count in enumerate(bodies.count):
        x, y = bodies.corners[b, :count, 0], bodies.corners[b, :count, 1]
        c, s = cos[:, b, None], sin[:, b, None]
        corners.append(np.stack([c * x - s * y, s * x + c * y], axis=2) + places[:, b, None, :2])
    return corners


def _estimate_radii(bodies: Bodies, places: FloatArray) -> FloatArray:
    """Estimate the radii (B,) of discs.

    A radius is the least distance of the centre from any polygon, or half of that from another disc.
    """
    radius = np.zeros(len(bodies.count))
    polygons = [
        corners for corners, disc in zip(_polygon_corners(bodies, places), bodies.discs, strict=True) if not disc
    ]
    discs = np.flatnonzero(bodies.discs)
    for b in discs:
        centre = places[:, b, :2]
        near = [_distance_to_polygon(centre, corners).min() for corners in polygons]
        near += [np.linalg.norm(places[:, c, :2] - centre, axis=1).min() / 2 for c in discs if c != b]
        radius[b] = min(near, default=1.0)
    return radius


def _distance_to_polygon(point: FloatArray, corners: FloatArray) -> FloatArray:
    """Compute the distances (T,) of points (T, 2) from the edges of polygons (T, n, 2)."""
    edge = np.roll(corners, -1, axis=1) - corners
    off = point[:, None] - corners
    share = ((off * edge).sum(axis=2) / (edge**2).sum(axis=2)).clip(0, 1)
    return np.asarray(np.linalg.norm(off - share[..., None] * edge, axis=2).min(axis=1), np.float64)


def _find_boundaries(
    bodies: Bodies, t: FloatArray, places: FloatArray, radius: FloatArray, gravity: FloatArray, sigma: float
) -> FloatArray:
    """Find boundaries (W, 3) where at least two bodies were pushed back at the end of all motion on a side."""
    push = _sample_accelerations(t, places) - gravity  # (T - 2, B, 2)
    size = np.linalg.norm(push, axis=2)
    least = max(
        BOUNDARY_PUSH * float(np.linalg.norm(gravity)),
        BOUNDARY_PUSH * float(np.percentile(size, 99)),
        acceleration_error(t, sigma),
    )
    corners, boundaries = _polygon_corners(bodies, places), []
    for normal in BOUNDARY_NORMALS:
        lowest = np.stack([(c @ normal).min(axis=1) - r for c, r in zip(corners, radius, strict=True)], axis=1)
        highest = max(float((c @ normal).max()) for c in corners)
        near = lowest < lowest.min() + BOUNDARY_DISTANCE * (highest - lowest.min())  # (T, B)
        pushed = near[1:-1] & (push @ normal > least)
        if pushed.any(axis=0).sum() >= 2:
            boundaries.append([*normal, _estimate_boundary_offset(lowest[near])])
    return np.array(boundaries).reshape(-1, 3)


def _estimate_boundary_offset(lowest: FloatArray) -> float:
    """Estimate the most frequent distance of bodies near an end.

    It is the half-sample mode (Robertson and Cryer 1974), since a bouncing body is rarely observed at the moment of
    contact.
    """
    left = np.sort(lowest)
    while len(left) > 2:
        half = (len(left) + 1) // 2
        widths = left[half - 1 :] - left[: len(left) - half + 1]
        start = int(np.argmin(widths))
        left = left[start : start + half]
    return float(left.mean())


def _sample_accelerations(t: FloatArray, places: FloatArray) -> FloatArray:
    """Compute the accelerations (T - 2, B, 2) at the inner samples."""
    span = np.diff(t)
    rate = np.diff(places[..., :2], axis=0) / span[:, None, None]
    return np.asarray(2 * np.diff(rate, axis=0) / (span[1:] + span[:-1])[:, None, None], np.float64)


def acceleration_error(t: FloatArray, sigma: float) -> float:
    """Compute the acceleration that noise alone can cause."""
    return SIGNIFICANT_SIGMAS * 2.5 * sigma / float(np.median(np.diff(t))) ** 2
