"""Balls cut out of a picture with their soft edge and shadow, and pasted elsewhere, between pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from video.plate import Plate, fill_behind

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Picture = NDArray[np.uint8]

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


@dataclass(frozen=True, slots=True)
class Outline:
    """Where a ball is during the exposure of a picture: a disc along a way; px."""

    way: Floats
    """(P, 2) px, P >= 1; one point for a sharp ball; the middle is the place at mid-exposure."""
    centre: Floats
    """(2,) px at mid-exposure."""
    radius: float
    """px"""

    def distance(self, x0: int, y0: int, width: int, height: int) -> Singles:
        """Distance (h, w) in px of the pixels of a box from the way; the ball's edge is at `radius`."""
        x = np.arange(x0, x0 + width, dtype=np.float32)[None, None, :]
        y = np.arange(y0, y0 + height, dtype=np.float32)[None, :, None]
        start = self.way.astype(np.float32)
        if len(start) == 1:
            alone: Singles = np.hypot(x - start[0, 0], y - start[0, 1])[0]
            return alone
        ax, ay = (start[:-1, k][:, None, None] for k in (0, 1))
        dx, dy = (np.diff(start[:, k])[:, None, None] for k in (0, 1))
        share = np.clip(((x - ax) * dx + (y - ay) * dy) / np.maximum(dx * dx + dy * dy, 1e-6), 0, 1)
        nearest: Singles = np.sqrt(((x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2).min(axis=0))
        return nearest

    @property
    def edge(self) -> float:
        """px beyond the radius that still belong to the ball."""
        return max(LEAST_EDGE, EDGE_RADII * self.radius)

    @property
    def reach(self) -> float:
        """px from the way to the outer border of the ring."""
        return (SHADOW_RADII + RING_RADII) * self.radius + 2 * self.edge


@dataclass(frozen=True, slots=True)
class Sprite:
    """A ball cut out: its colour with a soft mask, and how it shades the cloth around."""

    x: int
    y: int
    """px of the top-left pixel in the picture that it was cut from."""
    centre: Floats
    """(2,) px, where the ball was."""
    shade: Singles
    """(h, w, 3) brightness around the ball with it over without it, minus 1; 0 far away."""
    cover: Singles
    """(k, l, 4) colour times mask, and mask 0 to 1: the part that is not empty."""
    inset: tuple[int, int]
    """Columns and rows of `shade` before those of `cover`."""


@dataclass(frozen=True, slots=True)
class Peeled:
    """A picture parted into what is behind the moving balls and the balls."""

    behind: Picture
    """(H, W, 3)"""
    sprites: tuple[Sprite | None, ...]
    """One per outline; None where nothing of the ball lies inside the picture."""


def peel(
    picture: Picture, outlines: Sequence[Outline], others: Sequence[Outline], plate: Plate, motion: Floats | None
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
        layers.append(None if box is None else _erase(behind, picture, outline, near, box, plate, motion))
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
    behind: Picture,
    picture: Picture,
    outline: Outline,
    near: Sequence[Outline],
    box: tuple[int, int, int, int],
    plate: Plate,
    motion: Floats | None,
) -> tuple[Singles, Singles]:
    """Paint the table over one ball in `behind`; returns the masks (h, w) of the ball and of all that it touches."""
    x, y, width, height = box
    distance = outline.distance(*box)
    radius, edge = outline.radius, outline.edge
    mine = np.ones_like(distance)
    clear = np.ones(distance.shape, dtype=bool)
    for other in near:
        theirs = other.distance(*box) - other.radius
        mine *= np.clip((theirs - (distance - radius)) / 2 + 0.5, 0, 1)
        clear &= theirs > other.edge + 1
    ball = np.clip((radius + 2 * edge - distance) / edge, 0, 1) * mine
    shadow = np.clip((SHADOW_RADII * radius + edge - distance) / (FADE_RADII * radius), 0, 1) * mine
    here = np.s_[y : y + height, x : x + width]
    around, known = plate.patch(x, y, width, height, motion)
    ring = clear & known & (distance > SHADOW_RADII * radius + edge)
    ground = fill_behind(picture[here], around, ring)
    touched = np.where(known, np.maximum(ball, np.where(clear, shadow, 0)), 0)
    patch = behind[here].astype(np.float32)
    behind[here] = np.rint(patch + (ground - patch) * touched[..., None]).astype(np.uint8)
    return ball, touched


def _cut(
    picture: Picture, behind: Picture, outline: Outline, ball: Singles, touched: Singles, box: tuple[int, int, int, int]
) -> Sprite | None:
    """The sprite of one ball, from the picture with and without it; None where nothing of it shows."""
    x, y, width, height = box
    here = np.s_[y : y + height, x : x + width]
    seen, empty = picture[here].astype(np.float32), behind[here].astype(np.float32)
    mask = np.where(touched > 0, ball, 0)[..., None]
    rows, columns = (np.flatnonzero(mask[..., 0].any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    tight = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shade = np.clip((seen + 2) / (empty + 2), *SHADE_LIMITS) - 1
    shade *= (touched > 0)[..., None]
    cover = np.concatenate([seen * mask, mask], axis=2)[tight]
    return Sprite(x, y, outline.centre, shade, cover, (int(columns[0]), int(rows[0])))


def paste(picture: Picture, layers: Sequence[tuple[Sprite, Floats, float]]) -> None:
    """Lay one ball over `picture` in place, mixed from sprites: each with the centre (2,) px to put it at and a weight.

    Weights add to 1, or to less for a ball that fades.
    """
    shades, covers = [], []
    for sprite, centre, weight in layers:
        corner = np.array([sprite.x, sprite.y]) + centre - sprite.centre
        shades.append((sprite.shade, corner, weight, cv2.INTER_LINEAR))
        covers.append((sprite.cover, corner + sprite.inset, weight, cv2.INTER_CUBIC))
    for kind, parts in enumerate((shades, covers)):
        box = _hull(picture, parts)
        if box is None:
            continue
        ground = picture[box[1] : box[3], box[0] : box[2]]
        layer = _moved(box, parts)
        kept, added = (1 + layer, 0.0) if kind == 0 else (1 - np.clip(layer[..., 3:], 0, 1), layer[..., :3])
        ground[:] = np.rint(np.clip(ground * kept + added, 0, 255)).astype(np.uint8)


def _hull(picture: Picture, parts: Sequence[tuple[Singles, Floats, float, int]]) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 of the box around patches put at corners, cut at the picture; None if it is empty."""
    corners = np.array([corner for _, corner, *_ in parts])
    ends = corners + [patch.shape[1::-1] for patch, *_ in parts]
    x0, y0 = (int(v) for v in np.maximum(np.floor(corners.min(axis=0)), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(ends.max(axis=0)), picture.shape[1::-1]))
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _moved(box: tuple[int, int, int, int], parts: Sequence[tuple[Singles, Floats, float, int]]) -> Singles:
    """The weighted sum of patches put at corners between pixels, in a box."""
    x0, y0, x1, y1 = box
    total = np.zeros((y1 - y0, x1 - x0, parts[0][0].shape[2]), dtype=np.float32)
    for patch, (x, y), weight, flags in parts:
        shift = np.array([[1.0, 0.0, x - x0], [0.0, 1.0, y - y0]])
        total += cv2.warpAffine(patch, shift, (x1 - x0, y1 - y0), flags=flags) * weight
    return total
