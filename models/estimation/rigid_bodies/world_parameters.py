"""What rigid bodies move under: gravity, friction, restitution, drag, boundaries; and first guesses of these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.rigid_bodies.body_clusters import Bodies

SIDES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Inward normals of the boundaries that are looked for."""
NEAR = 0.02
"""of the extent of all motion: bodies that come this near to its end on one side can have met a boundary there."""
PUSHED = 0.25
"""of gravity, and of strong accelerations: what pushes bodies harder from a side is a boundary."""
STEADY = 0.05
"""share by which the acceleration may differ between two intervals of free flight."""
LEAST_FLIGHTS = 3
"""pairs of intervals of free flight by which gravity is known."""
STRIDES = (1, 2, 3, 5)
"""samples from one to the next."""
MOST_FLIGHTS = 2000
"""that are compared with each other."""
CLEARLY = 6.0
"""standard deviations that a bend must have to count as one."""
STILL = 1e-3
"""of a body's size: how far off a motion may be in the end because contacts were not pushed once more."""
SLACK = 1e-3
"""of a body's size: overlap that stays, so that lasting contacts are found again."""


@dataclass(frozen=True, slots=True)
class World:
    """Numbers that hold for all bodies. Lengths and times are the caller's."""

    gravity: FloatArray
    """(2,)"""
    friction: float
    restitution: float
    drag: float
    """1/time: share of its velocity that a body loses."""
    radius: FloatArray
    """(B,) of discs, 0 for polygons."""
    density: float
    """of discs, that of polygons being 1."""
    planes: FloatArray
    """(W, 3) inward normals and offsets of straight boundaries."""

    @property
    def key(self) -> tuple[float, ...]:
        """All numbers that are sought."""
        return (*self.gravity.tolist(), self.friction, self.restitution, self.drag, self.density, *self.radius.tolist())

    def lightness(self, bodies: Bodies) -> FloatArray:
        """(B, 2) one over mass and one over moment of inertia."""
        discs = bodies.discs
        area = np.where(discs, np.pi * self.radius**2 * self.density, bodies.area)
        moment = np.where(discs, self.radius**2 / 2, bodies.moment)
        # bodies of the usual size weigh about 1
        mass = area / np.median(area)
        return np.stack([1 / mass, 1 / (mass * moment)], axis=1)

    def laws(self, bodies: Bodies) -> FloatArray:
        """(7,) for `models.physics.rigid_bodies.contact_impulses.march`."""
        size = bodies.size if np.isfinite(bodies.size) else float(np.median(self.radius))
        return np.array([*self.gravity, self.friction, self.restitution, self.drag, SLACK * size, STILL * size])


def guessed(bodies: Bodies, t: FloatArray, places: FloatArray, sigma: float) -> list[World]:
    """Worlds to begin a search with, from places (T, B, 3) at t (T,) with standard deviation sigma: with the gravity
    that is seen, and with none, since seen from above what slows down looks like falling."""
    radius = _radii(bodies, places)
    seen = _gravity(t, places, sigma)
    return [
        World(gravity, 0.3, 0.2, 0.0, radius, 1.0, _planes(bodies, t, places, radius, gravity, sigma))
        for gravity in ([seen, np.zeros(2)] if seen.any() else [seen])
    ]


def _gravity(t: FloatArray, places: FloatArray, sigma: float) -> FloatArray:
    """Gravity seen over every sample, or over every few where noise hides it between neighbours."""
    for stride in STRIDES:
        found = _steady(t[::stride], places[::stride], sigma) if len(t) > 4 * stride else np.zeros(2)
        if found.any():
            return found
    return np.zeros(2)


def _steady(t: FloatArray, places: FloatArray, sigma: float) -> FloatArray:
    """The acceleration that most bodies keep for two intervals running: nothing but gravity is so steady and common."""
    bend, error = _bends(t, places), bend_error(t, sigma)
    middle = (bend[:-1] + bend[1:]) / 2
    size = np.linalg.norm(middle, axis=2)
    steady = (np.linalg.norm(np.diff(bend, axis=0), axis=2) < STEADY * size + error / CLEARLY) & (size > error)
    flights = middle[steady][:MOST_FLIGHTS]
    if len(flights) < LEAST_FLIGHTS:
        return np.zeros(2)
    near = (
        np.linalg.norm(flights[:, None] - flights, axis=2) < STEADY * np.linalg.norm(flights, axis=1) + error / CLEARLY
    )
    chosen = near[:, int(np.argmax(near.sum(axis=0)))]
    if chosen.sum() < LEAST_FLIGHTS:
        return np.zeros(2)
    return np.asarray(np.median(flights[chosen], axis=0), np.float64)


def _corners(bodies: Bodies, places: FloatArray) -> list[FloatArray]:
    """(T, n, 2) corners of every body as seen."""
    cos, sin = np.cos(places[..., 2]), np.sin(places[..., 2])
    found = []
    for b, count in enumerate(bodies.count):
        x, y = bodies.corners[b, :count, 0], bodies.corners[b, :count, 1]
        c, s = cos[:, b, None], sin[:, b, None]
        found.append(np.stack([c * x - s * y, s * x + c * y], axis=2) + places[:, b, None, :2])
    return found


def _radii(bodies: Bodies, places: FloatArray) -> FloatArray:
    """(B,) of discs: the least distance of the centre from any polygon, or half of that from another disc."""
    radius = np.zeros(len(bodies.count))
    polygons = [corners for corners, disc in zip(_corners(bodies, places), bodies.discs, strict=True) if not disc]
    discs = np.flatnonzero(bodies.discs)
    for b in discs:
        centre = places[:, b, :2]
        near = [_distance(centre, corners).min() for corners in polygons]
        near += [np.linalg.norm(places[:, c, :2] - centre, axis=1).min() / 2 for c in discs if c != b]
        radius[b] = min(near, default=1.0)
    return radius


def _distance(point: FloatArray, corners: FloatArray) -> FloatArray:
    """(T,) of points (T, 2) from the edges of polygons (T, n, 2)."""
    edge = np.roll(corners, -1, axis=1) - corners
    off = point[:, None] - corners
    share = ((off * edge).sum(axis=2) / (edge**2).sum(axis=2)).clip(0, 1)
    return np.asarray(np.linalg.norm(off - share[..., None] * edge, axis=2).min(axis=1), np.float64)


def _planes(
    bodies: Bodies, t: FloatArray, places: FloatArray, radius: FloatArray, gravity: FloatArray, sigma: float
) -> FloatArray:
    """(W, 3) where at least two bodies were pushed back at the end of all motion on a side."""
    push = _bends(t, places) - gravity  # (T - 2, B, 2)
    size = np.linalg.norm(push, axis=2)
    least = max(PUSHED * float(np.linalg.norm(gravity)), PUSHED * float(np.percentile(size, 99)), bend_error(t, sigma))
    corners, found = _corners(bodies, places), []
    for normal in SIDES:
        lowest = np.stack([(c @ normal).min(axis=1) - r for c, r in zip(corners, radius, strict=True)], axis=1)
        highest = max(float((c @ normal).max()) for c in corners)
        near = lowest < lowest.min() + NEAR * (highest - lowest.min())  # (T, B)
        pushed = near[1:-1] & (push @ normal > least)
        if pushed.any(axis=0).sum() >= 2:
            found.append([*normal, _end(lowest[near])])
    return np.array(found).reshape(-1, 3)


def _end(lowest: FloatArray) -> float:
    """Where most of the distances lie that bodies near an end keep: the densest half (half-sample mode, Robertson and
    Cryer 1974), since a body that bounces is rarely seen at the moment of contact."""
    left = np.sort(lowest)
    while len(left) > 2:
        half = (len(left) + 1) // 2
        widths = left[half - 1 :] - left[: len(left) - half + 1]
        start = int(np.argmin(widths))
        left = left[start : start + half]
    return float(left.mean())


def _bends(t: FloatArray, places: FloatArray) -> FloatArray:
    """(T - 2, B, 2) accelerations at the inner samples."""
    span = np.diff(t)
    rate = np.diff(places[..., :2], axis=0) / span[:, None, None]
    return np.asarray(2 * np.diff(rate, axis=0) / (span[1:] + span[:-1])[:, None, None], np.float64)


def bend_error(t: FloatArray, sigma: float) -> float:
    """What noise alone can make of an acceleration."""
    return CLEARLY * 2.5 * sigma / float(np.median(np.diff(t))) ** 2
