"""Random arrangement of balls in training images: positions, motion during the exposure, mutual occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from video.rendering.random_scene import RandomScene
from video.rendering.scene_renderer import BallPoses, Motion

# Largest number of balls in an image.
MAX_BALLS = 22
# Largest displacement during the exposure, in ball radii, and in px at the detector's scale.
MAX_STREAK_RADII, MAX_STREAK_PX = 7.0, 62.0
# Share of images with a triangle of touching balls, and share with moving balls.
RACK_SHARE, MOVING_SHARE = 0.15, 0.6
# Share of balls that touch the previously placed ball, and share on its line of sight: one then covers the other.
TOUCHING_SHARE, COVERED_SHARE = 0.2, 0.2
# Largest distance between the apparent centres of such a pair, along the line of sight and across it, in radii.
MAX_COVERING_RADII, MAX_BESIDE_RADII = 1.9, 1.2
# Mean number of moving balls in an image with motion: far more than in clips, where streaks are too rare to learn.
MEAN_MOVING_BALLS = 3.0
# Share of moving balls that roll; the others slide without rotating.
ROLLING_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class BallArrangement:
    """N balls in one image; the exposure lasts from t = -1/2 to 1/2."""

    look_index: NDArray[np.int64]
    """(N,) index into the scene's ball appearances."""
    position: FloatArray
    """(N, 2) m at mid-exposure."""
    displacement: FloatArray
    """(N, 2) m during the exposure."""
    rotation: FloatArray
    """(N, 3, 3) at mid-exposure."""
    is_rolling: NDArray[np.bool_]
    """(N,) True where the ball rolls."""
    radius: float
    """m."""

    def ball_motion(self) -> Motion:
        """Return the function from time to poses."""
        return self._poses_at

    def _poses_at(self, t: float) -> BallPoses:
        xyz = np.column_stack([self.position + t * self.displacement, np.full(len(self.position), self.radius)])
        rotation = np.array(
            [
                r if not m or not w.any() else _rolling_rotation(t * w / self.radius) @ r
                for r, w, m in zip(self.rotation, self.displacement, self.is_rolling, strict=True)
            ]
        )
        return BallPoses(xyz, rotation.reshape(-1, 3, 3))


def _rolling_rotation(angle: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of a ball that rolled by (x, y) radii."""
    size = float(np.linalg.norm(angle))
    # wx = -vy / R, wy = vx / R
    x, y, _ = axis = np.array([-angle[1], angle[0], 0.0]) / max(size, 1e-12)
    cross = np.array([[0, 0, y], [0, 0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.cos(size) * np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * np.outer(axis, axis)
    return rotation


def arrange_balls(rng: np.random.Generator, scene: RandomScene, magnify: int = 1) -> BallArrangement:
    """Arrange balls at random on the visible part of the table; some touch, some move.

    Args:
        rng: source of randomness.
        scene: table, camera and balls.
        magnify: factor by which the rendered image is later scaled down.

    Returns:
        The arrangement.
    """
    wanted = int(rng.integers(0, 3)) if rng.random() < 0.15 else int(rng.integers(2, MAX_BALLS))
    start = _place_rack(rng, scene) if rng.random() < RACK_SHARE else np.empty((0, 2))
    positions = _place_balls(rng, scene, start, max(wanted, len(start)))[:MAX_BALLS]
    n = len(positions)
    moving_share = MEAN_MOVING_BALLS / max(n, 1) if rng.random() < MOVING_SHARE else 0.0
    moving = np.flatnonzero(rng.random(n) < moving_share)
    displacement = np.zeros((n, 2))
    for ball in moving:
        displacement[ball] = _sample_displacement(rng, scene, positions[ball], magnify)
    rotation = np.array([_sample_rotation(rng) for _ in range(n)]).reshape(-1, 3, 3)
    return BallArrangement(
        rng.integers(0, len(scene.balls), n),
        positions,
        displacement,
        rotation,
        rng.random(n) < ROLLING_SHARE,
        scene.table.ball_radius,
    )


def _sample_visible_positions(rng: np.random.Generator, scene: RandomScene, count: int) -> FloatArray:
    """Sample positions (n, 2) m on the table whose ball is visible, up to half a radius beyond the image border."""
    camera, table = scene.camera, scene.table
    r = table.ball_radius
    px = rng.uniform(-0.03, 1.03, (count, 2)) * (camera.width_px, camera.height_px)
    xy = camera.to_table(px, r)
    inside = (xy >= r).all(axis=1) & (xy[:, 0] <= table.length - r) & (xy[:, 1] <= table.width - r)
    # Rays near the horizon intersect the plane behind the camera.
    ahead = (np.column_stack([xy, np.full(count, r), np.ones(count)]) @ scene.camera.matrix[2]) > 0
    return np.asarray(xy[inside & ahead])


def _place_balls(rng: np.random.Generator, scene: RandomScene, start: FloatArray, wanted: int) -> FloatArray:
    """Return positions (n, 2) m, `start` first, of balls that do not overlap."""
    radius = scene.table.ball_radius
    positions = list(start)
    for candidate in _sample_visible_positions(rng, scene, 12 * wanted + 20):
        if len(positions) >= wanted:
            break
        position = candidate
        chance = rng.random() if positions else 1.0
        if chance < TOUCHING_SHARE:
            angle = rng.uniform(0, 2 * np.pi)
            position = positions[-1] + 2.003 * radius * np.array([np.cos(angle), np.sin(angle)])
        elif chance < TOUCHING_SHARE + COVERED_SHARE:
            position = _sample_position_in_sight_line(rng, scene, positions[-1])
        if _is_free(position, positions, radius) and _is_on_table(scene, position):
            positions.append(position)
    return np.array(positions).reshape(-1, 2)


def _sample_position_in_sight_line(rng: np.random.Generator, scene: RandomScene, other: FloatArray) -> FloatArray:
    """Sample a position (2,) m on the line of sight to another ball; lower cameras give larger distances."""
    radius = scene.table.ball_radius
    sight = np.append(other, radius) - scene.camera.position
    away = sight[:2] / max(float(np.linalg.norm(sight[:2])), 1e-9)
    across = np.array([-away[1], away[0]])
    farthest = MAX_COVERING_RADII * float(np.linalg.norm(sight)) / max(-float(sight[2]), radius)
    ahead = rng.uniform(2.003, max(farthest, 2.1)) * float(rng.choice([-1.0, 1.0]))
    return np.asarray(other + radius * (ahead * away + rng.uniform(-MAX_BESIDE_RADII, MAX_BESIDE_RADII) * across))


def _is_free(position: FloatArray, positions: list[FloatArray], radius: float) -> bool:
    return not positions or bool((np.linalg.norm(np.array(positions) - position, axis=1) >= 2 * radius).all())


def _is_on_table(scene: RandomScene, position: FloatArray) -> bool:
    r, table = scene.table.ball_radius, scene.table
    inside = bool(
        (position >= 0.99 * r).all()
        and position[0] <= table.length - 0.99 * r
        and position[1] <= table.width - 0.99 * r
    )
    clear = not len(table.pocket_centres) or np.linalg.norm(table.pocket_centres - position, axis=1).min() > 1.5 * r
    return inside and bool(clear)


def _place_rack(rng: np.random.Generator, scene: RandomScene) -> FloatArray:
    """Place a triangle of touching balls; return the positions (n, 2) m that are on the table."""
    apexes = _sample_visible_positions(rng, scene, 8)
    if not len(apexes):
        return np.empty((0, 2))
    step, turn = 2.002 * scene.table.ball_radius, rng.uniform(0, 2 * np.pi)
    rows = int(rng.integers(2, 6))
    local = np.array(
        [[row * step * np.sqrt(0.75), (i - row / 2) * step] for row in range(rows) for i in range(row + 1)]
    )
    cos, sin = np.cos(turn), np.sin(turn)
    positions = apexes[0] + local @ np.array([[cos, sin], [-sin, cos]])
    return np.asarray(positions[[_is_on_table(scene, position) for position in positions]], dtype=np.float64)


def _sample_displacement(
    rng: np.random.Generator, scene: RandomScene, position: FloatArray, magnify: int
) -> FloatArray:
    """Sample a displacement (2,) m during the exposure; short ones are more frequent."""
    radius_px = float(scene.camera.radius_px(position, scene.table.ball_radius))
    longest = min(MAX_STREAK_RADII * radius_px, MAX_STREAK_PX * magnify)
    px = longest * rng.random() ** 1.5
    angle = rng.uniform(0, 2 * np.pi)
    heading = np.array([np.cos(angle), np.sin(angle)])
    jacobian = np.linalg.inv(scene.camera.metres_per_pixel(position, scene.table.ball_radius))
    return np.asarray(heading * px / max(float(np.linalg.norm(jacobian @ heading)), 1e-9))


def _sample_rotation(rng: np.random.Generator) -> FloatArray:
    """Sample a uniform rotation (3, 3): QR of a normal matrix with determinant 1."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))
