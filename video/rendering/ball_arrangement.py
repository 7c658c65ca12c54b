"""Where the balls of a training picture lie, how they move during its exposure, and what of them is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from video.rendering.random_hall import Hall
from video.rendering.scene_renderer import Motion, Poses

MOST_BALLS = 22
MOST_STREAK_RADII, MOST_STREAK_PX = 7.0, 62.0
"""Way travelled during the exposure, in radii of the ball, and in px at the detector's scale."""
RACK_SHARE, MOVING_SHARE = 0.15, 0.6
"""Share of pictures with balls that touch in a triangle, and with balls in motion."""
TOUCHING_SHARE, COVERED_SHARE = 0.2, 0.2
"""Share of balls that touch the one placed before them, and of those in its line of sight: one covers the other."""
COVERING_RADII, BESIDE_RADII = 1.9, 1.2
"""How far apart the centres of such a pair are seen at the most, along the line of sight and across it."""
MOVING_BALLS = 3.0
"""How many balls of such a picture move, on average: far more than in a clip, where streaks are too rare to learn."""
TURN_SHARE = 0.7
"""Share of moving balls that roll; the others slide without turning."""


@dataclass(frozen=True, slots=True)
class Layout:
    """N balls in one picture; the exposure lasts from t = -1/2 to 1/2."""

    which: NDArray[np.int64]
    """(N,) into the hall's balls."""
    place: FloatArray
    """(N, 2) m at mid-exposure."""
    way: FloatArray
    """(N, 2) m travelled during the exposure."""
    rotation: FloatArray
    """(N, 3, 3) at mid-exposure."""
    turns: NDArray[np.bool_]
    """(N,) whether it rolls."""
    radius: float
    """m."""

    def motion(self) -> Motion:
        """Poses at any time."""
        return self._at

    def _at(self, t: float) -> Poses:
        xyz = np.column_stack([self.place + t * self.way, np.full(len(self.place), self.radius)])
        rotation = np.array(
            [
                r if not m or not w.any() else _rolled(t * w / self.radius) @ r
                for r, w, m in zip(self.rotation, self.way, self.turns, strict=True)
            ]
        )
        return Poses(xyz, rotation.reshape(-1, 3, 3))


def _rolled(angle: FloatArray) -> FloatArray:
    """Rotation (3, 3) of a ball that rolled by (x, y) radii."""
    size = float(np.linalg.norm(angle))
    # wx = -vy / R, wy = vx / R
    x, y, _ = axis = np.array([-angle[1], angle[0], 0.0]) / max(size, 1e-12)
    cross = np.array([[0, 0, y], [0, 0, -x], [-y, x, 0.0]])
    turned: FloatArray = np.cos(size) * np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * np.outer(axis, axis)
    return turned


def random_layout(rng: np.random.Generator, hall: Hall, magnify: int = 1) -> Layout:
    """Balls in the part of the table that the camera sees, some touching, some moving."""
    wanted = int(rng.integers(0, 3)) if rng.random() < 0.15 else int(rng.integers(2, MOST_BALLS))
    start = _rack(rng, hall) if rng.random() < RACK_SHARE else np.empty((0, 2))
    place = _filled(rng, hall, start, max(wanted, len(start)))[:MOST_BALLS]
    n = len(place)
    share = MOVING_BALLS / max(n, 1) if rng.random() < MOVING_SHARE else 0.0
    moving = np.flatnonzero(rng.random(n) < share)
    way = np.zeros((n, 2))
    for ball in moving:
        way[ball] = _way(rng, hall, place[ball], magnify)
    rotation = np.array([_random_rotation(rng) for _ in range(n)]).reshape(-1, 3, 3)
    return Layout(
        rng.integers(0, len(hall.balls), n), place, way, rotation, rng.random(n) < TURN_SHARE, hall.table.ball_radius
    )


def _seen_places(rng: np.random.Generator, hall: Hall, count: int) -> FloatArray:
    """Places (n, 2) m on the table whose ball is in the picture, up to half a radius beyond its border."""
    camera, table = hall.camera, hall.table
    r = table.ball_radius
    px = rng.uniform(-0.03, 1.03, (count, 2)) * (camera.width_px, camera.height_px)
    xy = camera.to_table(px, r)
    inside = (xy >= r).all(axis=1) & (xy[:, 0] <= table.length - r) & (xy[:, 1] <= table.width - r)
    # Rays near the horizon meet the plane behind the eye.
    ahead = (np.column_stack([xy, np.full(count, r), np.ones(count)]) @ hall.camera.matrix[2]) > 0
    return np.asarray(xy[inside & ahead])


def _filled(rng: np.random.Generator, hall: Hall, start: FloatArray, wanted: int) -> FloatArray:
    """Places (n, 2) m, `start` first, no two balls nearer than touching."""
    radius = hall.table.ball_radius
    placed = list(start)
    for drawn in _seen_places(rng, hall, 12 * wanted + 20):
        if len(placed) >= wanted:
            break
        place = drawn
        chance = rng.random() if placed else 1.0
        if chance < TOUCHING_SHARE:
            angle = rng.uniform(0, 2 * np.pi)
            place = placed[-1] + 2.003 * radius * np.array([np.cos(angle), np.sin(angle)])
        elif chance < TOUCHING_SHARE + COVERED_SHARE:
            place = _in_line(rng, hall, placed[-1])
        if _free(place, placed, radius) and _on_table(hall, place):
            placed.append(place)
    return np.array(placed).reshape(-1, 2)


def _in_line(rng: np.random.Generator, hall: Hall, other: FloatArray) -> FloatArray:
    """A place (2,) m behind or before another ball, as the camera sees it: the lower the camera, the farther off."""
    radius = hall.table.ball_radius
    sight = np.append(other, radius) - hall.camera.eye
    away = sight[:2] / max(float(np.linalg.norm(sight[:2])), 1e-9)
    across = np.array([-away[1], away[0]])
    farthest = COVERING_RADII * float(np.linalg.norm(sight)) / max(-float(sight[2]), radius)
    ahead = rng.uniform(2.003, max(farthest, 2.1)) * float(rng.choice([-1.0, 1.0]))
    return np.asarray(other + radius * (ahead * away + rng.uniform(-BESIDE_RADII, BESIDE_RADII) * across))


def _free(place: FloatArray, placed: list[FloatArray], radius: float) -> bool:
    return not placed or bool((np.linalg.norm(np.array(placed) - place, axis=1) >= 2 * radius).all())


def _on_table(hall: Hall, place: FloatArray) -> bool:
    r, table = hall.table.ball_radius, hall.table
    inside = bool(
        (place >= 0.99 * r).all() and place[0] <= table.length - 0.99 * r and place[1] <= table.width - 0.99 * r
    )
    clear = not len(table.pocket_centres) or np.linalg.norm(table.pocket_centres - place, axis=1).min() > 1.5 * r
    return inside and bool(clear)


def _rack(rng: np.random.Generator, hall: Hall) -> FloatArray:
    """A triangle of touching balls (n, 2) m, as far as it lies on the table."""
    apexes = _seen_places(rng, hall, 8)
    if not len(apexes):
        return np.empty((0, 2))
    step, turn = 2.002 * hall.table.ball_radius, rng.uniform(0, 2 * np.pi)
    rows = int(rng.integers(2, 6))
    local = np.array(
        [[row * step * np.sqrt(0.75), (i - row / 2) * step] for row in range(rows) for i in range(row + 1)]
    )
    cos, sin = np.cos(turn), np.sin(turn)
    places = apexes[0] + local @ np.array([[cos, sin], [-sin, cos]])
    return np.asarray(places[[_on_table(hall, place) for place in places]], dtype=np.float64)


def _way(rng: np.random.Generator, hall: Hall, place: FloatArray, magnify: int) -> FloatArray:
    """m travelled during the exposure: short ways more often than long ones."""
    radius_px = float(hall.camera.radius_px(place, hall.table.ball_radius))
    longest = min(MOST_STREAK_RADII * radius_px, MOST_STREAK_PX * magnify)
    px = longest * rng.random() ** 1.5
    angle = rng.uniform(0, 2 * np.pi)
    heading = np.array([np.cos(angle), np.sin(angle)])
    jacobian = np.linalg.inv(hall.camera.metres_per_pixel(place, hall.table.ball_radius))
    return np.asarray(heading * px / max(float(np.linalg.norm(jacobian @ heading)), 1e-9))


def _random_rotation(rng: np.random.Generator) -> FloatArray:
    """Uniform rotation (3, 3): QR of a normal matrix, determinant made 1."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))
