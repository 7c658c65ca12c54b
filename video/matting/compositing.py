"""Balls laid over a picture, between pixels: moved, mixed from two sightings, streaked along a way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter

import cv2
import numpy as np

from models.core.typing import Float32Array, FloatArray, ImageArray
from video.flow.optical_flow import grid
from video.matting.ball_matting import Outline, Sprite

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1"""

MOST_SHADES = 5
"""Places over which a shadow is averaged: it is soft."""


@dataclass(frozen=True, slots=True)
class Turned:
    """Where what a ball shows lies in a sighting of it from which it went round; g pixels around its centre."""

    bend: Float32Array
    """(g, g, 2) px, taken from every pixel's place before the sighting is looked up."""
    facing: Float32Array | None = None
    """(g, g) how much each place counts, 0 to 1: out of sight not at all; None: all alike."""
    inner: Float32Array | None = None
    """(g, g) share of each pixel that goes round, the rest is the ball's edge; None: all of it."""
    light: Float32Array | None = None
    """(g, g, 3) levels by which the light, which does not go round, makes it brighter here than it was there."""
    darkest: Float32Array | None = None
    """(3,) levels below which no light leaves it: gloss that is taken for broader than it is would leave a hole."""

    def lit(self, colour: Float32Array, light: Float32Array, mask: Float32Array | float = 1.0) -> Float32Array:
        """Colours (h, w, 3) times a mask (h, w, 1) with a light (h, w, 3) added."""
        there = colour + light * mask
        if self.darkest is None:
            return np.asarray(there, dtype=np.float32)
        return np.asarray(np.maximum(there, np.minimum(colour, self.darkest * mask)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Layer:
    """A sprite with the places (P, 2) px of its centre, over which it is averaged, and a weight."""

    sprite: Sprite
    places: FloatArray
    weight: float
    turned: Turned | None = None


def paste(picture: ImageArray, balls: Sequence[Sequence[Layer]], still: Sequence[Outline] = ()) -> list[Box]:
    """Lay balls over `picture` (H, W, 3) in place: the shadows of all, then the balls, the lowest in the picture last.

    Returns the boxes that were changed.

    The weights of a ball's layers add to 1, or to less for a ball that fades. Balls that are `still` in the picture
    take no shadow, and hide what is laid behind them: what is higher in the picture.
    """
    balls = [layers for layers in balls if layers]
    changed = [_paste_shade(picture, layers, still) for layers in balls]
    for low, layers in sorted(((_low(layers), layers) for layers in balls), key=itemgetter(0)):
        _paste_cover(picture, layers, [other for other in still if other.centre[1] > low])
    return [box for box in changed if box is not None]


def _low(layers: Sequence[Layer]) -> float:
    return float(_middle(layers[0].places)[1])


def _middle(places: FloatArray) -> FloatArray:
    """(2,) The mean; of one place, as is usual, without the work."""
    return np.asarray(places[0] if len(places) == 1 else places.mean(axis=0), dtype=np.float64)


def _paste_shade(picture: ImageArray, layers: Sequence[Layer], still: Sequence[Outline]) -> Box | None:
    """Darken the ground; returns the box around the ball and all that it shades, None outside the picture."""
    corners = [_corner(layer) for layer in layers]
    box = _hull(picture, [layer.sprite.shade for layer in layers], corners, layers)
    if box is None:
        return None
    total: Float32Array | None = None
    for layer, corner in zip(layers, corners, strict=True):
        places = _thinned(layer.places)
        for place in places:
            moved, weight = (
                _moved(layer.sprite.shade, corner + place, box, cv2.INTER_LINEAR),
                layer.weight / len(places),
            )
            total = moved * np.float32(weight) if total is None else _added(total, moved, weight)
    assert total is not None
    free = _free(still, box)
    total = total + 1 if free is None else total * free + 1
    ground = picture[box[1] : box[3], box[0] : box[2]]
    ground[:] = cv2.multiply(ground, total, dtype=cv2.CV_8U)
    return box


def _added(total: Float32Array, patch: Float32Array, weight: float) -> Float32Array:
    return np.asarray(cv2.scaleAdd(patch, weight, total), dtype=np.float32)


def _paste_cover(picture: ImageArray, layers: Sequence[Layer], in_front: Sequence[Outline]) -> None:
    corners = [_corner(layer) + layer.sprite.inset for layer in layers]
    box = _hull(picture, [layer.sprite.cover for layer in layers], corners, layers)
    if box is None:
        return
    total = _averaged(layers, [_looked_up(layer, corner, box) for layer, corner in zip(layers, corners, strict=True)])
    free = _free(in_front, box)
    total = total if free is None else total * free
    ground = picture[box[1] : box[3], box[0] : box[2]]
    through = 1 - np.minimum(np.maximum(total[..., 3:], 0), 1)
    ground[:] = cv2.add(ground * through, np.ascontiguousarray(total[..., :3]), dtype=cv2.CV_8U)


def _averaged(layers: Sequence[Layer], looked: Sequence[tuple[Float32Array, Float32Array | None]]) -> Float32Array:
    """(h, w, 4) The colours and masks of layers, each by its weight and by how well it was seen."""
    sum_of = sum(layer.weight for layer in layers)
    whole = min(1.0, sum_of)
    if all(seen is None for _, seen in looked):
        times = whole / max(sum_of, 1e-6)
        total = looked[0][0] * np.float32(layers[0].weight * times)
        for layer, (cover, _) in zip(layers[1:], looked[1:], strict=True):
            total = _added(total, cover, layer.weight * times)
        return total
    shares = [layer.weight if seen is None else layer.weight * seen[..., None]
              for layer, (_, seen) in zip(layers, looked, strict=True)]  # fmt: skip
    by = whole / np.maximum(sum(shares), 1e-6)
    mixed = sum(cover * share for (cover, _), share in zip(looked, shares, strict=True)) * by
    return np.asarray(mixed, dtype=np.float32)


def _free(balls: Sequence[Outline], box: Box) -> Float32Array | None:
    """(h, w, 1) 0 on balls, 1 elsewhere; None where there are none."""
    x0, y0, x1, y1 = box
    free: Float32Array | None = None
    for ball in balls:
        (x, y), reach = ball.centre, ball.reach
        if x0 - reach < x < x1 + reach and y0 - reach < y < y1 + reach:
            apart = ball.distance(x0, y0, x1 - x0, y1 - y0) - ball.radius
            mine: Float32Array = np.clip(apart / ball.edge, 0, 1)[..., None]
            free = mine if free is None else free * mine
    return free


def _looked_up(layer: Layer, corner: FloatArray, box: Box) -> tuple[Float32Array, Float32Array | None]:
    """Colours and mask (h, w, 4), and how well they were seen (h, w), of a layer in a box; None: wholly."""
    if layer.turned is not None:
        return _turned(layer, layer.turned, corner, box)
    cover = _moved(layer.sprite.cover, corner + layer.places[0], box, cv2.INTER_CUBIC)
    for place in layer.places[1:]:
        cover += _moved(layer.sprite.cover, corner + place, box, cv2.INTER_CUBIC)
    if len(layer.places) > 1:
        cover /= np.float32(len(layer.places))
    hidden = layer.sprite.hidden
    if hidden is None:
        return cover, None
    return cover, 1 - _moved(hidden, corner + _middle(layer.places), box, cv2.INTER_LINEAR)


def _turned(layer: Layer, turned: Turned, corner: FloatArray, box: Box) -> tuple[Float32Array, Float32Array | None]:
    """The same where what is on the ball goes round with it."""
    place = _middle(layer.places)
    shift = (np.array(box[:2]) - corner - place).astype(np.float32)
    first = place - (turned.bend.shape[0] - 1) / 2
    there = grid(box[3] - box[1], box[2] - box[0]) + shift
    where = there - _moved(turned.bend, first, box, cv2.INTER_LINEAR)
    cover = _remapped(layer.sprite.cover, where, cv2.INTER_CUBIC)
    hidden = layer.sprite.hidden
    seen = None if hidden is None else 1 - _remapped(hidden, where, cv2.INTER_LINEAR)
    if turned.light is not None:
        light = _moved(turned.light, first, box, cv2.INTER_LINEAR)
        cover[..., :3] = turned.lit(cover[..., :3], light, cover[..., 3:])
    if turned.facing is not None:
        facing = 1 - _moved(1 - turned.facing, first, box, cv2.INTER_LINEAR)
        seen = facing if seen is None else seen * facing
    if turned.inner is not None:
        inner = _moved(turned.inner, first, box, cv2.INTER_LINEAR)
        still = _remapped(layer.sprite.cover, there, cv2.INTER_CUBIC)
        cover = still + (cover - still) * inner[..., None]
        uncovered = 1.0 if hidden is None else 1 - _remapped(hidden, there, cv2.INTER_LINEAR)
        seen = None if seen is None else np.asarray(uncovered + (seen - uncovered) * inner, dtype=np.float32)
    return cover, seen


def _remapped(patch: Float32Array, where: Float32Array, flags: int) -> Float32Array:
    return np.asarray(cv2.remap(patch, where, None, flags, borderMode=cv2.BORDER_CONSTANT), dtype=np.float32)


def _corner(layer: Layer) -> FloatArray:
    """(2,) px of the first pixel of the shade, relative to the ball's centre."""
    return np.array([layer.sprite.x, layer.sprite.y]) - layer.sprite.centre


def _thinned(places: FloatArray) -> FloatArray:
    if len(places) <= MOST_SHADES:
        return places
    chosen = np.linspace(0, len(places) - 1, MOST_SHADES).round().astype(int)
    return np.asarray(places[chosen], dtype=np.float64)


def _hull(
    picture: ImageArray, patches: Sequence[Float32Array], corners: Sequence[FloatArray], layers: Sequence[Layer]
) -> Box | None:
    """The box around patches with corners at the places of their layers, cut at the picture; None if it is empty."""
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for patch, corner, layer in zip(patches, corners, layers, strict=True):
        ends = layer.places if len(layer.places) == 1 else (layer.places.min(axis=0), layer.places.max(axis=0))
        (low_x, low_y), (high_x, high_y) = (corner + ends[0]).tolist(), (corner + ends[-1]).tolist()
        left, top = min(left, low_x), min(top, low_y)
        right, bottom = max(right, high_x + patch.shape[1]), max(bottom, high_y + patch.shape[0])
    x0, y0 = max(math.floor(left), 0), max(math.floor(top), 0)
    x1, y1 = min(math.ceil(right) + 1, picture.shape[1]), min(math.ceil(bottom) + 1, picture.shape[0])
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _moved(patch: Float32Array, corner: FloatArray, box: Box, flags: int) -> Float32Array:
    """A patch put at a corner between pixels, in a box."""
    shift = np.array([[1.0, 0.0, corner[0] - box[0]], [0.0, 1.0, corner[1] - box[1]]])
    return np.asarray(cv2.warpAffine(patch, shift, (box[2] - box[0], box[3] - box[1]), flags=flags), dtype=np.float32)
