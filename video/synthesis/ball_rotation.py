"""Rotation of the markings of a ball (dots, stripes and numbers) by its fitted spin, out of sight and into it.

A ball that rolls its own radius rotates by 57 degrees; its markings move farther between two frames than optical flow
can follow, and half of them go out of sight. The rotation follows from the motion of the ball. The light does not
rotate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate

import cv2
import numpy as np

from models.core.trajectory import State
from models.core.typing import Float32Array, FloatArray
from video.flow.optical_flow import pixel_grid
from video.matting.ball_matting import MattedSprite, comparison_half_width
from video.matting.ball_timeline import BallTimeline
from video.matting.compositing import RotationWarp

# Integration steps of the spin between two frames.
ROTATION_STEPS = 16
# Share of a ball that must show another paint for its rotation to matter.
MIN_PAINT_CHANGE_SHARE = 0.003
# Radii between which the rotating part fades into the edge, which does not rotate: fringe and alpha belong to it.
RIM_RADII = (0.78, 0.95)
# Radii from the centre beyond which a view shows the edge, and weight of a place out of sight.
MAX_LOOKUP_RADII, MIN_VIEW_WEIGHT = 0.93, 0.03
# Cosines between surface normal and direction to the camera from which a place is visible at all, and well.
FACING_COSINES = (0.25, 0.45)
# Levels of 255 by which a place must differ to count as another paint; light changes by less.
CHANGED_LEVELS = 30.0
# Share of the squared change that an accepted rotation may leave, and share of the change that must be at places
# visible in both views for a rotation to be testable.
MAX_RESIDUAL_SHARE, MIN_TESTABLE_SHARE = 0.5, 0.15
# Candidate rotations about the vertical axis between two frames, as cues and cushions cause them.
VERTICAL_TURNS_RAD = tuple(sign * np.radians(angle) for angle in (8, 16, 24, 34, 46, 60) for sign in (1, -1))
# Cost below which no rotation about the vertical axis is sought, and reduction of the cost that one must give per rad.
MAX_COST_WITHOUT_SEARCH, VERTICAL_TURN_PENALTY = 0.2, 0.3
# Change in levels of 255 that is paint rather than light where no rotation is testable.
PAINT_LEVELS = 50.0
# px around a place within which an equal colour matches: edges are a pixel off.
NEIGHBOURHOOD = np.ones((3, 3), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class BallRotation:
    """Rotation of a ball from one frame to the next, in axes right, down and towards the camera."""

    rotations: FloatArray
    """(K + 1, 3, 3) rotations since the first frame, after equal parts of the gap."""
    radius: float
    """px."""
    paint_change: Float32Array
    """(g, g) certainty, 0 to 1, that a place shows another paint in the second view than in the first."""
    light: Float32Array
    """(g, g, 3) levels by which lamps brighten a place more than others, whatever its paint."""
    darkest_level: Float32Array
    """(3,) levels of the darkest paint."""

    def rotation_at(self, share: float) -> FloatArray:
        """Return the rotation (3, 3) from the first frame to a share of the gap, 0 to 1."""
        place = share * (len(self.rotations) - 1)
        k = min(int(place), len(self.rotations) - 2)
        step, _ = cv2.Rodrigues(self.rotations[k + 1] @ self.rotations[k].T)
        return np.asarray(_rotation_matrix((place - k) * step[:, 0]) @ self.rotations[k], dtype=np.float64)

    def warps_at(self, share: float) -> tuple[RotationWarp, RotationWarp]:
        """Return the warps of the view before and of the view after to a share of the gap, 0 to 1.

        Paint rotates only where it changes, here or at its source or target; gloss and shade stay.
        """
        outward, inner = _visible_hemisphere(self.radius)
        now = self.rotation_at(share)
        sources = [outward @ turn.T.astype(np.float32) for turn in (now.T, self.rotation_at(1.0) @ now.T)]
        bends = [_displacement_from(outward, place, self.radius) for place in sources]
        moved = self.paint_change
        for bend, place in zip(bends, sources, strict=True):
            moved = np.maximum(moved, np.where(place[..., 2] > 0, _displace_patch(self.paint_change, bend), 0))
        inner = np.asarray(inner * moved, dtype=np.float32)
        before, after = (
            RotationWarp(
                bend,
                np.clip(place[..., 2], MIN_VIEW_WEIGHT, 1) ** 2,
                inner,
                self.light - _displace_patch(self.light, bend),
                self.darkest_level,
            )
            for bend, place in zip(bends, sources, strict=True)
        )
        return before, after


def states_between_frames(timeline: BallTimeline, row: int) -> State:
    """Return the state of all balls (ROTATION_STEPS, N) in the middles of equal parts of the gap after a row."""
    first, last = timeline.t[row : row + 2]
    return timeline.state_at(first + (last - first) * (np.arange(ROTATION_STEPS) + 0.5) / ROTATION_STEPS)


def shows_other_paint(sprites: tuple[MattedSprite, MattedSprite], radius: float) -> bool:
    """Return whether enough of a ball shows another paint in the second view for its rotation to be seen."""
    return _ViewPair.from_sprites(sprites, radius).paint_change_share >= MIN_PAINT_CHANGE_SHARE


def estimate_rotation(
    timeline: BallTimeline, row: int, ball: int, state: State, sprites: tuple[MattedSprite, MattedSprite], radius: float
) -> BallRotation | None:
    """Estimate the rotation of a ball in the gap after a row.

    Args:
        timeline: Positions of the balls.
        row: Row of the first frame.
        ball: Index of the ball.
        state: Result of `states_between_frames` for the row.
        sprites: The ball in both frames.
        radius: Radius of the ball, px.

    Returns:
        The rotation; None where the spin is unknown, or the views contradict it.
    """
    axes = _camera_axes(timeline, state.xy[:, ball].mean(axis=0), float(timeline.t[row]))
    spin = _rotation_vectors(state, ball, axes, float(timeline.t[row + 1] - timeline.t[row]))
    if spin is None:
        return None
    pair = _ViewPair.from_sprites(sprites, radius)
    rotations = _accumulate_rotations(spin)
    result = pair.evaluate_rotation(rotations[-1])
    if not np.isfinite(state.w[:, ball, 2]).all() and result.cost > MAX_COST_WITHOUT_SEARCH:
        # The path of a ball does not determine its rotation about the vertical axis; its markings do.
        least = result.cost
        for angle in VERTICAL_TURNS_RAD:
            other = _accumulate_rotations(spin + angle / len(spin) * axes[:, 2])
            alternative = pair.evaluate_rotation(other[-1])
            if alternative.cost + VERTICAL_TURN_PENALTY * abs(angle) < least:
                least, rotations, result = alternative.cost + VERTICAL_TURN_PENALTY * abs(angle), other, alternative
    if not result.is_explained:
        return None
    paints = result.paint_levels()
    return BallRotation(rotations, radius, pair.paint_change, result.estimate_light(paints), paints[0])


def compare_rotated_views(
    sprites: tuple[MattedSprite, MattedSprite], radius: float, warps: tuple[RotationWarp, RotationWarp]
) -> float:
    """Return the mean squared difference, levels^2, of two views of a ball warped to the same time."""
    outward, _ = _visible_hemisphere(radius)
    rotated, weight = [], (outward[..., 2] > FACING_COSINES[1]).astype(np.float32)
    for sprite, warp in zip(sprites, warps, strict=True):
        view = _view_around_centre(sprite, radius)
        lit = _displace_patch(view, warp.displacement)
        if warp.light_difference is not None:
            lit = warp.add_light(lit, warp.light_difference)
        if warp.rotating_share is not None:
            lit = view + (lit - view) * warp.rotating_share[..., None]
        if warp.facing is not None:
            weight = np.minimum(weight, warp.facing)
        rotated.append(lit)
    return float((weight * ((rotated[0] - rotated[1]) ** 2).mean(axis=2)).sum() / max(float(weight.sum()), 1e-6))


def _rotation_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0], dtype=np.float64)


@lru_cache(maxsize=64)
def _visible_hemisphere(radius: float) -> tuple[Float32Array, Float32Array]:
    """Return the surface normals (g, g, 3) at the pixels around a ball's centre, and their rotating shares (g, g)."""
    half = comparison_half_width(radius)
    y, x = (np.mgrid[-half : half + 1, -half : half + 1] / radius).astype(np.float32)
    square = x * x + y * y
    inner = np.clip((RIM_RADII[1] - np.sqrt(square)) / (RIM_RADII[1] - RIM_RADII[0]), 0, 1)
    return np.stack([x, y, np.sqrt(np.maximum(1 - square, 0))], axis=-1), inner.astype(np.float32)


def _displacement_from(outward: Float32Array, source: Float32Array, radius: float) -> Float32Array:
    """Return the displacement (g, g, 2) px from where the point `source` (g, g, 3) is visible to each pixel.

    Points out of sight or on the edge are sampled at the nearest place that is not; off the ball it is 0.
    """
    reach = np.maximum(np.hypot(source[..., 0], source[..., 1]), 1e-6)
    scale = np.where(source[..., 2] < 0, MAX_LOOKUP_RADII, np.minimum(reach, MAX_LOOKUP_RADII)) / reach
    on_ball = np.hypot(outward[..., 0], outward[..., 1]) < 1
    offset = (outward[..., :2] - source[..., :2] * scale[..., None]) * np.float32(radius)
    return np.asarray(np.where(on_ball[..., None], offset, 0), dtype=np.float32)


def _displace_patch(patch: Float32Array, displacement: Float32Array) -> Float32Array:
    """Sample a patch (g, g, ...) at each place minus a displacement (g, g, 2)."""
    side = displacement.shape[0]
    return np.asarray(cv2.remap(patch, pixel_grid(side, side) - displacement, None, cv2.INTER_LINEAR), dtype=np.float32)


def _rotation_vectors(state: State, ball: int, axes: FloatArray, seconds: float) -> FloatArray | None:
    """Return the fitted rotation vectors (K, 3) in equal parts of the gap, in the axes of the frame."""
    spin = state.w[:, ball].copy()
    spin[:, 2] = np.nan_to_num(spin[:, 2])
    if not np.isfinite(spin).all() or state.measured[:, ball].any():
        return None
    return np.asarray(np.linalg.det(axes) * spin @ axes.T * (seconds / len(spin)), dtype=np.float64)


def _accumulate_rotations(vectors: FloatArray) -> FloatArray:
    """Return the rotations (K + 1, 3, 3) after each of the rotation vectors (K, 3)."""
    angle = np.sqrt((vectors**2).sum(axis=1))[:, None, None]
    (x, y, z), none = (vectors / np.maximum(angle[:, 0], 1e-12)).T, np.zeros(len(vectors))
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
    steps = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)  # formula of Rodrigues
    return np.stack([*accumulate(steps, lambda before, step: step @ before, initial=np.eye(3))])


def _camera_axes(timeline: BallTimeline, xy: FloatArray, t: float) -> FloatArray:
    """Return the rows right, down and towards the camera (3, 3) at a ball, in the axes of the table."""
    camera, size = timeline.scene.camera, timeline.scene.table.ball_radius
    steps = 0.5 * size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    points = [
        timeline.to_frame_pixels(camera.to_pixels((xy + step[:2])[None], size + float(step[2])), t)[0] for step in steps
    ]
    right, down = (np.array(points[1:]) - points[0]).T
    right = right / np.linalg.norm(right)
    down = down - (down @ right) * right
    down = down / np.linalg.norm(down)
    near = np.cross(right, down)
    return np.stack([right, down, near if near @ (camera.position - np.array([*xy, size])) > 0 else -near])


@lru_cache(maxsize=64)
def _view_around_centre(sprite: MattedSprite, radius: float) -> Float32Array:
    """Return the levels (g, g, 3) of a view around the ball's centre.

    Cached and read-only: a view ends one gap and begins the next.
    """
    cover = sprite.patch_around_centre(sprite.rgba, comparison_half_width(radius))
    return np.asarray(cover[..., :3] / np.maximum(cover[..., 3:], 0.2), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class _ViewPair:
    """Two views of a ball, and their differences."""

    views: tuple[Float32Array, Float32Array]
    """(g, g, 3) levels of each view."""
    radius: float
    """px."""
    bounds: tuple[tuple[Float32Array, Float32Array], tuple[Float32Array, Float32Array]]
    """Maximum and minimum (g, g, 3) of each view within a pixel: edges are a pixel off."""
    changes: tuple[Float32Array, Float32Array]
    """(g, g) levels by which each view exceeds the bounds of the other."""
    paint_change: Float32Array
    """(g, g) certainty, 0 to 1, of another paint."""

    @classmethod
    def from_sprites(cls, sprites: tuple[MattedSprite, MattedSprite], radius: float) -> _ViewPair:
        """Compare the sprites of two frames."""
        views = _view_around_centre(sprites[0], radius), _view_around_centre(sprites[1], radius)
        bounds = tuple((cv2.dilate(one, NEIGHBOURHOOD), cv2.erode(one, NEIGHBOURHOOD)) for one in views)
        excess = _excess_levels(views[0], *bounds[1]), _excess_levels(views[1], *bounds[0])
        changes = np.abs(excess[0]).max(axis=2), np.abs(excess[1]).max(axis=2)
        moved = 1 - np.exp(-((np.maximum(*changes) / CHANGED_LEVELS) ** 2))
        return cls(views, radius, (bounds[0], bounds[1]), changes, moved.astype(np.float32))

    @property
    def paint_change_share(self) -> float:
        """Share of the rotating part with another paint."""
        inner = _visible_hemisphere(self.radius)[1]
        return float((inner * self.paint_change).sum() / inner.sum())

    def evaluate_rotation(self, rotation: FloatArray) -> _RotationFit:
        """Measure the difference that remains after a rotation (3, 3) from the first view to the second."""
        outward, inner = _visible_hemisphere(self.radius)
        gains, visibility = [], []
        for own, other, direction in zip(self.views, self.bounds[::-1], (rotation, rotation.T), strict=True):
            place = outward @ direction.T.astype(np.float32)
            bend = _displacement_from(outward, place, self.radius)
            gains.append(_excess_levels(own, _displace_patch(other[0], bend), _displace_patch(other[1], bend)))
            visibility.append(
                np.clip((place[..., 2] - FACING_COSINES[0]) / (FACING_COSINES[1] - FACING_COSINES[0]), 0, 1)
            )
        weight = inner * self.paint_change
        change = testable = residual = 0.0
        for change_there, gain, share in zip(self.changes, gains, visibility, strict=True):
            change += float((weight * change_there**2).sum())
            testable += float((weight * share * change_there**2).sum())
            residual += float((weight * share * np.abs(gain).max(axis=2) ** 2).sum())
        return _RotationFit(self.views, inner, gains, visibility, float(weight.sum()), change, testable, residual)


@dataclass(frozen=True, slots=True)
class _RotationFit:
    """Difference between two views that remains after a rotation."""

    views: tuple[Float32Array, Float32Array]
    """(g, g, 3) levels of each view."""
    rotating_share: Float32Array
    """(g, g) share that can rotate."""
    excess: list[Float32Array]
    """Levels (g, g, 3) by which each view exceeds the bounds of the other, rotated."""
    visibility: list[Float32Array]
    """Visibility (g, g), 0 to 1, of each place in the other view."""
    area: float
    """px with another paint."""
    change: float
    """levels^2 px, squared change without rotation."""
    testable: float
    """Part of the change at places visible in both views."""
    residual: float
    """Part of the testable change that remains after the rotation."""

    @property
    def cost(self) -> float:
        """Remaining share of the change; untestable change counts half."""
        return (self.residual + 0.5 * (self.change - self.testable)) / max(self.change, 1e-6)

    @property
    def is_explained(self) -> bool:
        """Whether little of the change remains."""
        if self.testable < MIN_TESTABLE_SHARE * self.change:
            return self.change > PAINT_LEVELS**2 * 2 * self.area
        return self.residual < MAX_RESIDUAL_SHARE * self.testable

    def paint_levels(self) -> tuple[Float32Array, Float32Array]:
        """Return the levels (3,) of the darkest and of the brightest paint on the ball."""
        on = self.rotating_share > 0
        levels = np.concatenate([self.views[0][on], self.views[1][on]])
        darkest, brightest = (np.percentile(levels, share, axis=0).astype(np.float32) for share in (10, 90))
        return darkest, brightest

    def estimate_light(self, paints: tuple[Float32Array, Float32Array]) -> Float32Array:
        """Return the levels (g, g, 3) by which lamps brighten a place more than others, whichever paint is there.

        A place that is brighter in both views than its paint is in the other view is lit by a lamp. Where only one view
        shows that paint elsewhere, it cannot be darker than the darkest paint on the ball.
        """
        darkest, brightest = paints
        below, above = np.minimum(*self.views) - darkest, brightest - np.maximum(*self.views)
        alone = [np.clip(gain, -np.maximum(above, 0), np.maximum(below, 0)) for gain in self.excess]
        is_agreed = self.excess[0] * self.excess[1] > 0
        agreed = np.where(is_agreed, np.sign(self.excess[0]) * np.minimum(*np.abs(self.excess)), 0)
        first, second = (share[..., None] for share in self.visibility)
        light = first * second * agreed + first * (1 - second) * alone[0] + second * (1 - first) * alone[1]
        return np.asarray(light * self.rotating_share[..., None], dtype=np.float32)


def _excess_levels(own: Float32Array, most: Float32Array, least: Float32Array) -> Float32Array:
    """Return the levels (g, g, 3) by which a view is above the maximum or, negative, below the minimum."""
    return np.asarray(np.maximum(own - most, 0) - np.maximum(least - own, 0), dtype=np.float32)
