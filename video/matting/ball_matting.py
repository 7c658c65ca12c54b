"""Matting of balls: each ball is cut out of a frame with its soft edge and its shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import BoolArray, Float32Array, FloatArray, ImageArray
from video.matting.background_plate import BackgroundPlate, relight_background

# Width beyond the measured radius that belongs to the ball, in radii and at least in px: optics and coding blur it.
EDGE_RADII, MIN_EDGE_PX = 0.10, 1.0
# Distance from the centre, in radii, up to which a ball darkens the cloth.
SHADOW_RADII = 2.0
# Width in radii over which the shadow fades out.
FADE_RADII = 0.5
# Width in radii of the ring outside the shadow that measures the light.
RING_RADII = 0.6
# Limits of the brightness ratio of a shadow and of a glow; larger changes are other objects.
SHADING_LIMITS = (0.3, 1.25)
# Levels of 255 by which a pixel may differ from the relit empty table and still be table; at twice that it is another
# object.
MAX_TABLE_DIFFERENCE = 14.0
# Distance from the centre, in radii plus px, within which optics, coding and sharpening add a coloured fringe to a
# ball; a cue is not distinguishable from the ball there.
HALO_RADII, HALO_PX = 1.15, 3.0
# Weight of colours that stand in for occluded ones; they count where no frame shows the ball.
MIN_VISIBILITY = 1e-3


# px between the places over which a streak is averaged, and the largest number of places.
PATH_SAMPLE_PX, MAX_PATH_SAMPLES = 0.7, 48
# Largest brightness of a ball in multiples of the sensor range: it is saturated after a quarter of the shutter time.
MAX_OVEREXPOSURE = 4.0
# Radii of motion during the shutter time from which a ball is a streak.
MIN_STREAK_RADII = 0.5


# x, y, width, height
Box = tuple[int, int, int, int]


def comparison_half_width(radius: float) -> int:
    """Return the half width of the window in which views of a ball are compared: the ball and its edge.

    Args:
        radius: Radius of the ball, px.

    Returns:
        Half width, px.
    """
    return int(np.ceil(1.15 * radius)) + 2


@dataclass(frozen=True, slots=True)
class BallOutline:
    """Outline of a ball during the shutter time of a frame: a disc along a path, px."""

    path: FloatArray
    """(P, 2) px, P >= 1; a single point for a sharp ball; the middle point is the place at mid-exposure."""
    centre: FloatArray
    """(2,) px at mid-exposure."""
    radius: float
    """px."""

    def distance_to_path(self, x0: int, y0: int, width: int, height: int) -> Float32Array:
        """Return the distance (h, w) px of the pixels of a box from the path; the edge of the ball is at `radius`."""
        x = np.arange(x0, x0 + width, dtype=np.float32)[None, None, :]
        y = np.arange(y0, y0 + height, dtype=np.float32)[None, :, None]
        start = self.path.astype(np.float32)
        if len(start) == 1:
            alone: Float32Array = np.hypot(x - start[0, 0], y - start[0, 1])[0]
            return alone
        ax, ay = (start[:-1, k][:, None, None] for k in (0, 1))
        dx, dy = (np.diff(start[:, k])[:, None, None] for k in (0, 1))
        share = np.clip(((x - ax) * dx + (y - ay) * dy) / np.maximum(dx * dx + dy * dy, 1e-6), 0, 1)
        nearest: Float32Array = np.sqrt(((x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2).min(axis=0))
        return nearest

    @property
    def is_streaked(self) -> bool:
        """Whether the ball moves so far that motion blurs its edge."""
        return float(np.hypot(*np.ptp(self.path, axis=0))) > MIN_STREAK_RADII * self.radius

    @property
    def edge_width(self) -> float:
        """Width beyond the radius that still belongs to the ball, px."""
        return max(MIN_EDGE_PX, EDGE_RADII * self.radius)

    @property
    def reach(self) -> float:
        """Distance from the path to the outer border of the ring, px."""
        return (SHADOW_RADII + RING_RADII) * self.radius + 2 * self.edge_width


def sample_path(path: FloatArray) -> FloatArray:
    """Sample a path evenly in time, densely enough for a smooth streak.

    Args:
        path: Points evenly in time (P, 2), px.

    Returns:
        Places (K, 2), px.
    """
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    count = int(np.clip(np.ceil(length / PATH_SAMPLE_PX), 1, MAX_PATH_SAMPLES))
    if count == 1 or len(path) == 1:
        return np.asarray(path[[len(path) // 2]], dtype=np.float64)
    place = (np.arange(count) + 0.5) / count * (len(path) - 1)
    knots = np.arange(len(path))
    return np.column_stack([np.interp(place, knots, path[:, axis]) for axis in (0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class MattedSprite:
    """A ball cut out of a frame: premultiplied colour with a soft alpha, and its shading of the surrounding cloth.

    Sprites compare by identity.
    """

    x: int
    """Left pixel of `shading` in the frame that the sprite comes from."""
    y: int
    """Top pixel of `shading` in that frame."""
    centre: FloatArray
    """(2,) px, centre of the ball in that frame."""
    shading: Float32Array
    """(h, w, 3) brightness around the ball with it over brightness without it, minus 1; 0 far away."""
    rgba: Float32Array
    """(k, l, 4) colour times alpha, and alpha 0 to 1, cropped to the non-empty part. Outside the alpha it holds the
    fringe: light that no shading of the background explains."""
    visibility: Float32Array
    """(k, l) 1 where the colour is visible, near 0 where another ball occludes it and the mean colour stands in."""
    rgba_offset: tuple[int, int]
    """Columns and rows of `shading` before those of `rgba`."""
    path: FloatArray
    """(P, 2) px relative to the centre: path of the ball while the shutter is open."""

    @property
    def streak_length(self) -> float:
        """Extent of the path, px."""
        return float(np.hypot(*np.ptp(self.path, axis=0)))

    def patch_around_centre(self, patch: Float32Array, half: int, magnification: float = 1.0) -> Float32Array:
        """Resample a patch aligned with `rgba` (k, l, ...) to (n, n, ...), `half` px to each side of the centre."""
        centre = self.centre_in_rgba
        side = round((2 * half + 1) * magnification)
        shift = np.array(
            [
                [magnification, 0, magnification * (half - centre[0])],
                [0, magnification, magnification * (half - centre[1])],
            ]
        )
        return np.asarray(cv2.warpAffine(patch, shift, (side, side), flags=cv2.INTER_CUBIC), dtype=np.float32)

    @property
    def centre_in_rgba(self) -> FloatArray:
        """(2,) px, centre of the ball in `rgba`."""
        return np.asarray(self.centre - (self.x, self.y) - self.rgba_offset, dtype=np.float64)

    @property
    def occlusion(self) -> Float32Array | None:
        """(k, l) 1 minus `visibility`; None where no other ball occludes any part, the usual case."""
        return None if self.visibility.min() == 1 else 1 - self.visibility


@dataclass(frozen=True, slots=True, eq=False)
class MattedFrame:
    """A frame separated into the background without the moving balls, and the balls. Compared by identity."""

    background: ImageArray
    """(H, W, 3)"""
    sprites: tuple[MattedSprite | None, ...]
    """One per outline; None where no part of the ball lies inside the frame."""


def matte_balls(
    image: ImageArray,
    outlines: Sequence[BallOutline],
    remaining: Sequence[BallOutline],
    plate: BackgroundPlate,
    motion: FloatArray | None,
) -> MattedFrame:
    """Separate balls from a frame.

    Compositing every sprite at its original place restores the frame.

    Args:
        image: Frame (H, W, 3).
        outlines: Outlines of the balls to separate.
        remaining: Outlines of the balls that stay in the background.
        plate: Background plate.
        motion: Camera motion (3, 3) from pixels of the plate to those of the frame; None for a still camera.

    Returns:
        The background and a sprite per outline.
    """
    background = image.copy()
    boxes = [find_box(outline.path, outline.reach, image.shape) for outline in outlines]
    layers = []
    for outline, box in zip(outlines, boxes, strict=True):
        near = [other for other in (*outlines, *remaining) if other is not outline and _overlap(outline, other)]
        stays = [other for other in remaining if _overlap(outline, other)]
        layers.append(
            None if 0 in box[2:] else _erase_ball(background, image, outline, near, stays, box, plate, motion)
        )
    sprites = [
        None if layer is None else _extract_sprite(image, background, outline, *layer, box)
        for outline, box, layer in zip(outlines, boxes, layers, strict=True)
    ]
    return MattedFrame(background, tuple(sprites))


def find_box(path: FloatArray, reach: float, shape: tuple[int, ...]) -> Box:
    """Find x, y, width and height of the pixels within `reach` px of a path (P, 2), cut at the border."""
    x0, y0 = (int(v) for v in np.maximum(np.floor(path.min(axis=0) - reach), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(path.max(axis=0) + reach) + 1, [shape[1], shape[0]]))
    return x0, y0, max(x1 - x0, 0), max(y1 - y0, 0)


def _overlap(a: BallOutline, b: BallOutline) -> bool:
    """Return whether the surroundings of two balls may overlap."""
    gap = np.maximum(a.path.min(axis=0) - b.path.max(axis=0), b.path.min(axis=0) - a.path.max(axis=0))
    return bool(np.hypot(*np.maximum(gap, 0)) < a.reach + b.reach)


def _erase_ball(
    background: ImageArray,
    image: ImageArray,
    outline: BallOutline,
    neighbours: Sequence[BallOutline],
    remaining: Sequence[BallOutline],
    box: Box,
    plate: BackgroundPlate,
    motion: FloatArray | None,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Paint the relit table over one ball in `background`, in place.

    Of the `neighbours`, those that `remain` keep their pixels. Returns four masks (h, w): the ball, its part that no
    other
    ball occludes, all affected pixels, and the affected pixels whose colour lens and coding mix with the ball's.
    """
    x, y, width, height = box
    distance = outline.distance_to_path(*box)
    radius, edge = outline.radius, outline.edge_width
    ownership, removable = np.ones_like(distance), np.ones_like(distance)
    clear = np.ones(distance.shape, dtype=bool)
    for other in neighbours:
        other_distance = other.distance_to_path(*box) - other.radius
        share = _ownership_share(distance - radius, other_distance, outline.centre[1] > other.centre[1])
        ownership *= share
        if any(other is one for one in remaining):
            removable *= share
        clear &= other_distance > other.edge_width + 1
    ball = np.clip((radius + 2 * edge - distance) / edge, 0, 1)
    shadow = np.clip((SHADOW_RADII * radius + edge - distance) / (FADE_RADII * radius), 0, 1) * ownership
    here = np.s_[y : y + height, x : x + width]
    plate_patch, valid = plate.extract_patch(x, y, width, height, motion)
    ring = clear & valid & (distance > SHADOW_RADII * radius + edge)
    ground = relight_background(image[here], plate_patch, ring)
    halo = distance < HALO_RADII * radius + HALO_PX
    shadow *= _shading_mask(image[here], ground, halo)
    touched = np.where(valid, np.maximum(ball * removable, np.where(clear, shadow, 0)), 0)
    patch = background[here].astype(np.float32)
    background[here] = np.rint(patch + (ground - patch) * touched[..., None]).astype(np.uint8)
    # Outside its disc a pixel belongs to the nearer ball; inside, another ball may occlude it.
    return (
        np.where(distance > radius, ball * ownership, ball),
        ownership,
        touched,
        np.where(halo & (ownership >= 1), touched, 0),
    )


def _ownership_share(distance: Float32Array, other: Float32Array, in_front: bool) -> Float32Array:
    """Return the share, 0 to 1, to which pixels belong to one of two balls, from their distances to both edges.

    Frames are upright, so the ball that is lower in the frame is nearer to the camera and occludes the other.
    """
    hidden = other - np.maximum(distance, 0) if not in_front else np.maximum(other, 0) - distance
    return np.asarray(np.clip(hidden / 2 + 0.5, 0, 1), dtype=np.float32)


def _shading_mask(patch: ImageArray, empty: Float32Array, ball: BoolArray) -> Float32Array:
    """Return a mask (h, w): 1 for the ball and for the table in another light, 0 for other objects such as a cue."""
    light = np.einsum("ijc,ijc->ij", patch, empty) / np.maximum(np.einsum("ijc,ijc->ij", empty, empty), 1)
    other = np.abs(patch - light[..., None] * empty).max(axis=2)  # what remains when brightness is matched
    fits = np.clip(2 - other / MAX_TABLE_DIFFERENCE, 0, 1) * ((light > SHADING_LIMITS[0]) & (light < SHADING_LIMITS[1]))
    fits = np.where(ball, 1, fits)
    return np.asarray(cv2.blur(cv2.erode(fits.astype(np.float32), np.ones((3, 3))), (3, 3)), dtype=np.float32)


def _extract_sprite(
    image: ImageArray,
    background: ImageArray,
    outline: BallOutline,
    ball: Float32Array,
    ownership: Float32Array,
    touched: Float32Array,
    halo: Float32Array,
    box: Box,
) -> MattedSprite | None:
    """Return the sprite of one ball from the frame with and without it; None where no part of it is visible."""
    x, y, width, height = box
    here = np.s_[y : y + height, x : x + width]
    patch, empty = image[here].astype(np.float32), background[here].astype(np.float32)
    mask = np.where((touched > 0) | (ownership < 1), ball, 0)[..., None]
    rows, columns = (np.flatnonzero(((mask[..., 0] > 0) | (halo > 0)).any(axis=axis)) for axis in (1, 0))
    if not mask.any() or not touched.any():
        return None
    tight = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shading = np.clip((patch + 2) / (empty + 2), *SHADING_LIMITS) - 1
    # Another ball's pixels measure its colour, no shading.
    shading = _extend_shading_under(shading * ((touched > 0) & (ownership >= 1))[..., None], ball > 0.99)
    if outline.is_streaked:
        return _extract_streaked_sprite(patch, empty, shading, outline, box)
    sure = (ownership[..., None] * mask)[tight]
    mean_colour = (patch[tight] * sure).sum(axis=(0, 1)) / max(float(sure.sum()), 1e-3)
    colour = mean_colour + (patch - mean_colour) * ownership[..., None]
    fringe = (patch - empty * (1 + shading)) * (1 - mask) * halo[..., None]
    rgba = np.empty((*sure.shape[:2], 4), dtype=np.float32)
    rgba[..., :3], rgba[..., 3:] = (colour * mask + fringe)[tight], mask[tight]
    offset = (int(columns[0]), int(rows[0]))
    visibility = np.maximum(ownership[tight], MIN_VISIBILITY)
    return MattedSprite(
        x, y, outline.centre, shading.astype(np.float32), rgba, visibility, offset, outline.path - outline.centre
    )


def _extend_shading_under(shading: Float32Array, ball: BoolArray) -> Float32Array:
    """Extend the shading around a ball smoothly under it, where a streaked ball is partly transparent."""
    outside = (~ball).astype(np.float32)
    size = 2 * int(max(ball.any(axis=0).sum(), ball.any(axis=1).sum()) // 2) + 1
    weight = cv2.blur(outside, (size, size))[..., None]
    smooth = cv2.blur(shading * outside[..., None], (size, size)) / np.maximum(weight, 1e-3)
    return np.where(ball[..., None], smooth, shading).astype(np.float32)


def _extract_streaked_sprite(
    patch: Float32Array,
    empty: Float32Array,
    shading: Float32Array,
    outline: BallOutline,
    box: Box,
) -> MattedSprite:
    """Return the sprite of a streak, whose alpha is the share of the shutter time for which the ball covers a pixel."""
    x, y, width, height = box
    places = sample_path(outline.path)
    mask = np.zeros((height, width), dtype=np.float32)
    across, down = np.arange(width) + x, np.arange(height) + y
    for tap in places:
        distance = np.hypot(across[None] - tap[0], down[:, None] - tap[1])
        mask += np.clip((outline.radius + 1.5 * outline.edge_width - distance) / outline.edge_width, 0, 1)
    mask /= len(places)
    rows, columns = (np.flatnonzero((mask > 0).any(axis=axis)) for axis in (1, 0))
    tight = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    table = empty * (1 + shading) * (1 - mask[..., None])
    colour = np.clip(patch - table, 0, 255 * np.minimum(MAX_OVEREXPOSURE * mask[..., None], 1))
    rgba = np.concatenate([colour, mask[..., None]], axis=2)[tight].astype(np.float32)
    offset = (int(columns[0]), int(rows[0]))
    return MattedSprite(
        x, y, outline.centre, shading, rgba, np.ones_like(mask[tight]), offset, outline.path - outline.centre
    )
