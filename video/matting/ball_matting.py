"""Balls cut out of a picture with their soft edge and shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import BoolArray, Float32Array, FloatArray, ImageArray
from video.io.pixel_kernels import unlike
from video.matting.background_plate import Plate, fill_behind

EDGE_RADII, LEAST_EDGE = 0.10, 1.0
"""Width beyond the seen radius that belongs to the ball: share of the radius, and px: optics and coding blur it."""
SHADOW_RADII = 2.0
"""Distance from the centre, in radii, up to which a ball darkens the cloth."""
FADE_RADII = 0.5
"""Width over which the shadow is let go."""
RING_RADII = 0.6
"""Width of the ring outside the shadow that tells the light."""
SHADE_LIMITS = (0.3, 1.25)
"""How far a shadow may darken and a glow may brighten: beyond are other things."""
OTHER_COLOUR = 14.0
"""Levels of 255 by which a pixel may differ from the empty table in another light and still be the table; at twice
that it is something else."""
HALO_RADII, HALO_PX = 1.15, 3.0
"""Distance from the centre, in radii and then px, within which optics, coding and sharpening fringe a ball with other
colours: no cue is told from the ball there."""
LEAST_SEEN = 1e-3
"""Weight of colours that stand in for hidden ones: they count where no picture shows the ball."""


TAP, MOST_TAPS = 0.7, 48
"""px between the places over which a streak is averaged; and no more of them than this."""
OVEREXPOSED = 4.0
"""Times the sensor's range that a ball may be bright: after a quarter of the exposure it is white already."""
STREAKED_RADII = 0.5
"""Radii that a ball goes during an exposure from which it is a streak."""


def reach_around(radius: float) -> int:
    """px to each side of a ball's centre within which its sightings are compared: the ball and its edge."""
    return int(np.ceil(1.15 * radius)) + 2


@dataclass(frozen=True, slots=True)
class Outline:
    """Where a ball is during the exposure of a picture: a disc along a way; px."""

    way: FloatArray
    """(P, 2) px, P >= 1; one point for a sharp ball; the middle is the place at mid-exposure."""
    centre: FloatArray
    """(2,) px at mid-exposure."""
    radius: float
    """px"""

    def distance(self, x0: int, y0: int, width: int, height: int) -> Float32Array:
        """Distance (h, w) in px of the pixels of a box from the way; the ball's edge is at `radius`."""
        x = np.arange(x0, x0 + width, dtype=np.float32)[None, None, :]
        y = np.arange(y0, y0 + height, dtype=np.float32)[None, :, None]
        start = self.way.astype(np.float32)
        if len(start) == 1:
            alone: Float32Array = np.hypot(x - start[0, 0], y - start[0, 1])[0]
            return alone
        ax, ay = (start[:-1, k][:, None, None] for k in (0, 1))
        dx, dy = (np.diff(start[:, k])[:, None, None] for k in (0, 1))
        share = np.clip(((x - ax) * dx + (y - ay) * dy) / np.maximum(dx * dx + dy * dy, 1e-6), 0, 1)
        nearest: Float32Array = np.sqrt(((x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2).min(axis=0))
        return nearest

    @property
    def streaked(self) -> bool:
        """Whether the ball went so far that its own edge is a blur."""
        return float(np.hypot(*np.ptp(self.way, axis=0))) > STREAKED_RADII * self.radius

    @property
    def edge(self) -> float:
        """px beyond the radius that still belong to the ball."""
        return max(LEAST_EDGE, EDGE_RADII * self.radius)

    @property
    def reach(self) -> float:
        """px from the way to the outer border of the ring."""
        return (SHADOW_RADII + RING_RADII) * self.radius + 2 * self.edge


def taps_along(way: FloatArray) -> FloatArray:
    """Places (K, 2) px, evenly in time along a way (P, 2), close enough for a smooth streak."""
    length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    count = int(np.clip(np.ceil(length / TAP), 1, MOST_TAPS))
    if count == 1 or len(way) == 1:
        return np.asarray(way[[len(way) // 2]], dtype=np.float64)
    place = (np.arange(count) + 0.5) / count * (len(way) - 1)
    known = np.arange(len(way))
    return np.column_stack([np.interp(place, known, way[:, axis]) for axis in (0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class Sprite:
    """A ball cut out: its colour with a soft mask, and how it shades the cloth around. Each is itself alone."""

    x: int
    y: int
    """px of the top-left pixel in the picture that it was cut from."""
    centre: FloatArray
    """(2,) px, where the ball was."""
    shade: Float32Array
    """(h, w, 3) brightness around the ball with it over without it, minus 1; 0 far away."""
    cover: Float32Array
    """(k, l, 4) colour times mask, and mask 0 to 1: the part that is not empty. Around the mask what is left of a
    fringe: light that no shade of the ground accounts for."""
    seen: Float32Array
    """(k, l) 1 where the colour was seen, near 0 where another ball hid it and the mean of the rest stands in."""
    inset: tuple[int, int]
    """Columns and rows of `shade` before those of `cover`."""
    way: FloatArray
    """(P, 2) px relative to the centre: where the ball went while the shutter was open."""

    @property
    def streak(self) -> float:
        """px, how far it went."""
        return float(np.hypot(*np.ptp(self.way, axis=0)))

    def around(self, patch: Float32Array, half: int, times: float = 1.0) -> Float32Array:
        """A patch (k, l, ...) like the cover as (n, n, ...): `half` px to each side of the ball's centre."""
        centre = self.in_cover
        side = round((2 * half + 1) * times)
        shift = np.array([[times, 0, times * (half - centre[0])], [0, times, times * (half - centre[1])]])
        return np.asarray(cv2.warpAffine(patch, shift, (side, side), flags=cv2.INTER_CUBIC), dtype=np.float32)

    @property
    def in_cover(self) -> FloatArray:
        """(2,) px, where the ball's centre is in the cover."""
        return np.asarray(self.centre - (self.x, self.y) - self.inset, dtype=np.float64)

    @property
    def hidden(self) -> Float32Array | None:
        """(k, l) 1 less `seen`; None where no other ball hid any of it, as is usual."""
        return None if self.seen.min() == 1 else 1 - self.seen


@dataclass(frozen=True, slots=True)
class Peeled:
    """A picture parted into what is behind the moving balls and the balls."""

    behind: ImageArray
    """(H, W, 3)"""
    sprites: tuple[Sprite | None, ...]
    """One per outline; None where nothing of the ball lies inside the picture."""


def peel(
    picture: ImageArray, outlines: Sequence[Outline], others: Sequence[Outline], plate: Plate, motion: FloatArray | None
) -> Peeled:
    """Take the balls of `outlines` out of `picture` (H, W, 3); `others` are balls that stay.

    `motion` (3, 3) takes the plate's pixels to this picture's. Pasting every sprite where it was gives the picture
    back.
    """
    behind = picture.copy()
    boxes = [_box(outline, picture.shape) for outline in outlines]
    everyone = [*outlines, *others]
    layers = []
    for index, (outline, box) in enumerate(zip(outlines, boxes, strict=True)):
        near = [other for k, other in enumerate(everyone) if k != index and _meet(outline, other)]
        stay = [other for other in others if _meet(outline, other)]
        layers.append(None if box is None else _erase(behind, picture, outline, near, stay, box, plate, motion))
    sprites = [
        None if layer is None or box is None else _cut(picture, behind, outline, *layer, box)
        for outline, box, layer in zip(outlines, boxes, layers, strict=True)
    ]
    return Peeled(behind, tuple(sprites))


def _box(outline: Outline, shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """x, y, width, height of the pixels that a ball can touch, cut at the picture; None if there are none."""
    low = np.floor(outline.way.min(axis=0) - outline.reach).astype(int)
    high = np.ceil(outline.way.max(axis=0) + outline.reach).astype(int) + 1
    x0, y0 = (int(v) for v in np.maximum(low, 0))
    x1, y1 = (int(v) for v in np.minimum(high, [shape[1], shape[0]]))
    return (x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None


def _meet(a: Outline, b: Outline) -> bool:
    """True where the surroundings of two balls may overlap."""
    gap = np.maximum(a.way.min(axis=0) - b.way.max(axis=0), b.way.min(axis=0) - a.way.max(axis=0))
    return bool(np.hypot(*np.maximum(gap, 0)) < a.reach + b.reach)


def _erase(
    behind: ImageArray,
    picture: ImageArray,
    outline: Outline,
    near: Sequence[Outline],
    stay: Sequence[Outline],
    box: tuple[int, int, int, int],
    plate: Plate,
    motion: FloatArray | None,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Paint the table over one ball in `behind`.

    Of the balls that are `near`, those that `stay` keep their pixels. Returns (h, w): the mask of the ball, what of it
    no other ball hides, all that it touches, and the part of that which lens and coding fringe with its colours.
    """
    x, y, width, height = box
    distance = outline.distance(*box)
    radius, edge = outline.radius, outline.edge
    mine, left = np.ones_like(distance), np.ones_like(distance)
    clear = np.ones(distance.shape, dtype=bool)
    for other in near:
        theirs = other.distance(*box) - other.radius
        share = _share(distance - radius, theirs, outline.centre[1] > other.centre[1])
        mine *= share
        if any(other is one for one in stay):
            left *= share
        clear &= theirs > other.edge + 1
    ball = np.clip((radius + 2 * edge - distance) / edge, 0, 1)
    shadow = np.clip((SHADOW_RADII * radius + edge - distance) / (FADE_RADII * radius), 0, 1) * mine
    here = np.s_[y : y + height, x : x + width]
    around, known = plate.patch(x, y, width, height, motion)
    ring = clear & known & (distance > SHADOW_RADII * radius + edge)
    ground = fill_behind(picture[here], around, ring)
    halo = distance < HALO_RADII * radius + HALO_PX
    shadow *= _shaded(picture[here], ground, halo)
    touched = np.where(known, np.maximum(ball * left, np.where(clear, shadow, 0)), 0)
    patch = behind[here].astype(np.float32)
    behind[here] = np.rint(patch + (ground - patch) * touched[..., None]).astype(np.uint8)
    # what lies around the ball's own disc is another's where that is nearer; within it, another may hide the ball
    return np.where(distance > radius, ball * mine, ball), mine, touched, np.where(halo & (mine >= 1), touched, 0)


def _share(own: Float32Array, theirs: Float32Array, in_front: bool) -> Float32Array:
    """How far pixels belong to one of two balls, 0 to 1, by their distances from both edges.

    Pictures are upright, so the ball that is lower in the picture is nearer to the camera and hides the other.
    """
    hidden = theirs - np.maximum(own, 0) if not in_front else np.maximum(theirs, 0) - own
    return np.asarray(np.clip(hidden / 2 + 0.5, 0, 1), dtype=np.float32)


def _shaded(seen: ImageArray, empty: Float32Array, ball: BoolArray) -> Float32Array:
    """(h, w) 1 where a picture shows the ball, or the empty table in another light; 0 where something else: a cue."""
    light, other = np.empty(ball.shape, dtype=np.float32), np.empty(ball.shape, dtype=np.float32)
    unlike(seen, empty, light, other)
    fits = np.clip(2 - other / OTHER_COLOUR, 0, 1) * ((light > SHADE_LIMITS[0]) & (light < SHADE_LIMITS[1]))
    fits = np.where(ball, 1, fits)
    return np.asarray(cv2.blur(cv2.erode(fits.astype(np.float32), np.ones((3, 3))), (3, 3)), dtype=np.float32)


def _cut(
    picture: ImageArray,
    behind: ImageArray,
    outline: Outline,
    ball: Float32Array,
    mine: Float32Array,
    touched: Float32Array,
    halo: Float32Array,
    box: tuple[int, int, int, int],
) -> Sprite | None:
    """The sprite of one ball, from the picture with and without it; None where nothing of it shows."""
    x, y, width, height = box
    here = np.s_[y : y + height, x : x + width]
    seen, empty = picture[here].astype(np.float32), behind[here].astype(np.float32)
    mask = np.where((touched > 0) | (mine < 1), ball, 0)[..., None]
    rows, columns = (np.flatnonzero(((mask[..., 0] > 0) | (halo > 0)).any(axis=axis)) for axis in (1, 0))
    if not mask.any() or not touched.any():
        return None
    tight = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shade = np.clip((seen + 2) / (empty + 2), *SHADE_LIMITS) - 1
    # Where another ball is, the picture tells that ball's colour and no shade.
    shade = _smoothed_under(shade * ((touched > 0) & (mine >= 1))[..., None], ball > 0.99)
    if outline.streaked:
        return _matted(seen, empty, shade, outline, box)
    sure = (mine[..., None] * mask)[tight]
    usual = (seen[tight] * sure).sum(axis=(0, 1)) / max(float(sure.sum()), 1e-3)
    colour = usual + (seen - usual) * mine[..., None]
    fringe = (seen - empty * (1 + shade)) * (1 - mask) * halo[..., None]
    cover = np.empty((*sure.shape[:2], 4), dtype=np.float32)
    cover[..., :3], cover[..., 3:] = (colour * mask + fringe)[tight], mask[tight]
    inset = (int(columns[0]), int(rows[0]))
    shown = np.maximum(mine[tight], LEAST_SEEN)
    return Sprite(x, y, outline.centre, shade.astype(np.float32), cover, shown, inset, outline.way - outline.centre)


def _smoothed_under(shade: Float32Array, ball: BoolArray) -> Float32Array:
    """The shade with that around the ball carried on under it: what a streaked ball lets through."""
    around = (~ball).astype(np.float32)
    size = 2 * int(max(ball.any(axis=0).sum(), ball.any(axis=1).sum()) // 2) + 1
    weight = cv2.blur(around, (size, size))[..., None]
    smooth = cv2.blur(shade * around[..., None], (size, size)) / np.maximum(weight, 1e-3)
    return np.where(ball[..., None], smooth, shade).astype(np.float32)


def _matted(
    seen: Float32Array, empty: Float32Array, shade: Float32Array, outline: Outline, box: tuple[int, int, int, int]
) -> Sprite:
    """The sprite of a streak: its mask is the share of the exposure for which the ball covered a pixel."""
    x, y, width, height = box
    taps = taps_along(outline.way)
    mask = np.zeros((height, width), dtype=np.float32)
    across, down = np.arange(width) + x, np.arange(height) + y
    for tap in taps:
        apart = np.hypot(across[None] - tap[0], down[:, None] - tap[1])
        mask += np.clip((outline.radius + 1.5 * outline.edge - apart) / outline.edge, 0, 1)
    mask /= len(taps)
    rows, columns = (np.flatnonzero((mask > 0).any(axis=axis)) for axis in (1, 0))
    tight = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    table = empty * (1 + shade) * (1 - mask[..., None])
    colour = np.clip(seen - table, 0, 255 * np.minimum(OVEREXPOSED * mask[..., None], 1))
    cover = np.concatenate([colour, mask[..., None]], axis=2)[tight].astype(np.float32)
    inset = (int(columns[0]), int(rows[0]))
    return Sprite(x, y, outline.centre, shade, cover, np.ones_like(mask[tight]), inset, outline.way - outline.centre)
