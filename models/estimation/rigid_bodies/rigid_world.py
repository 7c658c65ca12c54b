"""Rigid bodies and their world, as points that are fixed to the bodies show them.

A body with a single point is a disc of unknown radius; one with several is the convex polygon that they span, of
uniform density. Poses are (x, y, angle) of the polygon's centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from models.core.typing import FloatArray, IntArray

# Relative change of the distance of two points of one body that tracking errors may cause.
MAX_DISTANCE_CHANGE = 0.02
# Least area of a polygon, relative to the square of its extent.
MIN_RELATIVE_AREA = 1e-3


@dataclass(frozen=True, slots=True)
class Bodies:
    """B rigid bodies that N points are fixed to."""

    body: IntArray
    """(N,) body of each point."""
    offsets: FloatArray
    """(N, 2) of a point in the frame of its body's centre."""
    corners: FloatArray
    """(B, V, 2) of the polygons in the frame of the centre, in the sense of rotation from x to y; padded."""
    count: IntArray
    """(B,) corners of each; 1 for a disc."""
    area: FloatArray
    """(B,) of the polygons, NaN for discs."""
    moment: FloatArray
    """(B,) squared radius of gyration of the polygons, NaN for discs."""

    @property
    def discs(self) -> NDArray[np.bool_]:
        """(B,) whether a body is a disc."""
        return np.asarray(self.count == 1, np.bool_)

    @property
    def lever(self) -> FloatArray:
        """(B,) RMS distance of a body's points from its centre: length of a radian; 0 for discs."""
        squares = np.bincount(self.body, (self.offsets**2).sum(axis=1), len(self.count))
        return np.asarray(np.sqrt(squares / np.bincount(self.body, minlength=len(self.count))), np.float64)

    @property
    def size(self) -> float:
        """Median distance of a polygon's farthest corner from its centre; NaN where all are discs."""
        away = np.linalg.norm(self.corners, axis=2).max(axis=1)[~self.discs]
        return float(np.median(away)) if len(away) else float("nan")

    def point_positions(self, places: FloatArray) -> FloatArray:
        """Compute the positions (..., N, 2) of all points of bodies with poses (..., B, 3)."""
        at = places[..., self.body, :]
        return at[..., :2] + rotate_vectors(self.offsets, at[..., 2])


def rotate_vectors(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (..., 2) by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def group_rigid_points(x: FloatArray) -> IntArray:
    """Group points whose mutual distances are constant.

    Bodies that never move relative to each other cannot be separated.

    Args:
        x: (T, N, 2) positions.

    Returns:
        (N,) body of each point.
    """
    count = x.shape[1]
    rigid = np.zeros((count, count), np.bool_)
    for i in range(count):
        apart = np.linalg.norm(x - x[:, i : i + 1], axis=2)  # (T, N)
        middle = apart.mean(axis=0)
        rigid[i] = (middle > 0) & (np.ptp(apart, axis=0) < 2 * MAX_DISTANCE_CHANGE * middle)
    # two points are joined if nearly the same points are rigid to both: bodies that touch once stay separate
    common = (rigid | np.eye(count, dtype=bool)).astype(float)
    shared = common @ common
    alike = rigid & (shared > 0.5 * np.maximum.outer(shared.diagonal(), shared.diagonal()))
    return np.asarray(connected_components(coo_array(alike), directed=False)[1], np.int64)


def has_fixed_distances(x: FloatArray) -> bool:
    """Return whether points could be fixed to one body.

    Args:
        x: (T, n, D) positions, NaN where a point was not observed.

    Returns:
        True if no observed distance changes by more than tracking errors.
    """
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    with np.errstate(invalid="ignore"):
        spread = np.nanmax(apart, axis=0) - np.nanmin(apart, axis=0)
    return bool(np.all(spread <= 2 * MAX_DISTANCE_CHANGE * np.nanmax(apart)))


def assemble_bodies(x: FloatArray, body: IntArray) -> tuple[Bodies, FloatArray, float]:
    """Determine shapes and poses of bodies from their points.

    Args:
        x: (T, N, 2) positions of points.
        body: (N,) body of each point.

    Returns:
        The bodies, their poses (T, B, 3) with continuous angles, and the standard deviation of a coordinate: the RMS
        deviation from rigid bodies, NaN where every body has one point.
    """
    count = int(body.max()) + 1
    offsets, places = np.zeros(x.shape[1:]), np.zeros((len(x), count, 3))
    left, freedom = 0.0, 0
    shapes = []
    for b in range(count):
        mine = body == b
        shape = _estimate_shape(x[:, mine])
        hull, centre, area, moment = _polygon_properties(shape)
        offsets[mine] = shape - centre
        shapes.append((hull - centre, area, moment))
        places[:, b] = _fit_poses(x[:, mine], offsets[mine])
        points = int(mine.sum())
        if points > 1:
            predicted = places[:, b, None, :2] + rotate_vectors(offsets[mine][None], places[:, b, None, 2])
            left += float(((predicted - x[:, mine]) ** 2).sum())
            freedom += (len(x) - 1) * (2 * points - 3)
    corners = np.zeros((count, max(len(hull) for hull, _, _ in shapes), 2))
    for b, (hull, _, _) in enumerate(shapes):
        corners[b, : len(hull)] = hull
    counts = np.array([len(hull) for hull, _, _ in shapes])
    bodies = Bodies(body, offsets, corners, counts, *(np.array([shape[k] for shape in shapes]) for k in (1, 2)))
    return bodies, places, float(np.sqrt(left / freedom)) if freedom else float("nan")


def _estimate_shape(x: FloatArray) -> FloatArray:
    """Estimate the mean shape (n, 2) of points x (T, n, 2), in the orientation of the first frame."""
    shape: FloatArray = x[0] - x[0].mean(axis=0)
    for _ in range(3):
        at = _fit_poses(x, shape - shape.mean(axis=0))
        back = rotate_vectors(x - at[:, None, :2], -at[:, None, 2])
        shape = np.asarray(back.mean(axis=0), np.float64)
    return shape


def _fit_poses(x: FloatArray, offsets: FloatArray) -> FloatArray:
    """Fit the poses (T, 3) of a shape to points x (T, n, 2): Kabsch 1976, doi:10.1107/S0567739476001873."""
    middle, centre = offsets.mean(axis=0), x.mean(axis=1)
    shape, observed = offsets - middle, x - centre[:, None]
    across = (shape[:, 0] * observed[..., 1] - shape[:, 1] * observed[..., 0]).sum(axis=1)
    angle = np.unwrap(np.arctan2(across, (shape * observed).sum(axis=(1, 2))))
    return np.concatenate([centre - rotate_vectors(middle, angle), angle[:, None]], axis=1)


def _polygon_properties(shape: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Compute corners (n, 2), centre of mass, area and squared radius of gyration of the convex hull of points."""
    if len(shape) == 1:
        return shape, shape[0], float("nan"), float("nan")
    try:
        corners = shape[ConvexHull(shape).vertices]
    except QhullError:  # collinear points
        along = np.linalg.svd(shape - shape.mean(axis=0))[2][0]
        order = np.argsort(shape @ along)
        ends = shape[[order[0], order[-1]]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        return ends, ends.mean(axis=0), MIN_RELATIVE_AREA * length**2, length**2 / 12
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    area = cross.sum() / 2
    centre = ((corners + following) * cross[:, None]).sum(axis=0) / (6 * area)
    a, b = corners - centre, following - centre
    turns = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    second = (turns * ((a * a).sum(axis=1) + (a * b).sum(axis=1) + (b * b).sum(axis=1))).sum() / 12
    return corners, centre, float(area), float(second / area)


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
