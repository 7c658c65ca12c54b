"""Compositing of balls onto a frame with subpixel accuracy: moved, mixed from two views, blurred along a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import Float32Array, FloatArray, ImageArray
from video.flow.optical_flow import pixel_grid
from video.matting.ball_matting import BallOutline, MattedSprite

# x0, y0, x1, y1
Box = tuple[int, int, int, int]

# Places over which a shadow, which is soft, is averaged.
MAX_SHADING_CENTRES = 5


@dataclass(frozen=True, slots=True)
class RotationWarp:
    """Warp of a view of a ball to another rotation; g pixels around its centre."""

    displacement: Float32Array
    """(g, g, 2) px, subtracted from each pixel's place before the view is sampled."""
    facing: Float32Array | None = None
    """(g, g) weight of each place, 0 to 1, near 0 out of sight; None: all equal."""
    rotating_share: Float32Array | None = None
    """(g, g) share of each pixel that rotates, the rest is the edge of the ball; None: all of it."""
    light_difference: Float32Array | None = None
    """(g, g, 3) levels by which the light, which does not rotate, is brighter here than at the sampled place."""
    darkest_level: Float32Array | None = None
    """(3,) levels below which the light difference darkens nothing: gloss estimated too broad would leave a hole."""

    def add_light(self, colour: Float32Array, light: Float32Array, mask: Float32Array | float = 1.0) -> Float32Array:
        """Add a light (h, w, 3) to colours (h, w, 3) premultiplied by a mask (h, w, 1)."""
        lit = colour + light * mask
        if self.darkest_level is None:
            return np.asarray(lit, dtype=np.float32)
        return np.asarray(np.maximum(lit, np.minimum(colour, self.darkest_level * mask)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class SpriteLayer:
    """A sprite, the places (P, 2) px of its centre over which it is averaged, and its weight."""

    sprite: MattedSprite
    centres: FloatArray
    weight: float
    rotation: RotationWarp | None = None


def composite_balls(
    image: ImageArray, balls: Sequence[Sequence[SpriteLayer]], resting: Sequence[BallOutline] = ()
) -> list[Box]:
    """Composite balls onto a frame in place: first all shadows, then the balls from the top of the frame to the bottom.

    Args:
        image: Frame (H, W, 3).
        balls: Layers of each ball. Their weights add to 1, or to less for a ball that fades.
        resting: Balls that are part of the frame. They receive no shadow, and occlude balls that are higher in the
            frame.

    Returns:
        The boxes that changed.
    """
    balls = sorted((layers for layers in balls if layers), key=lambda layers: float(_mean_centre(layers[0].centres)[1]))
    boxes = [_shading_box(image.shape, layers) for layers in balls]
    for layers, box in zip(balls, boxes, strict=True):
        if box is not None:
            _composite_shading(image, layers, resting, box)
    for layers in balls:
        low = float(_mean_centre(layers[0].centres)[1])
        _composite_sprites(image, layers, [other for other in resting if other.centre[1] > low])
    return [box for box in boxes if box is not None]


def _mean_centre(centres: FloatArray) -> FloatArray:
    """Return the mean (2,) of places, without computation for a single place, the usual case."""
    return np.asarray(centres[0] if len(centres) == 1 else centres.mean(axis=0), dtype=np.float64)


def find_changed_boxes(shape: tuple[int, ...], balls: Sequence[Sequence[SpriteLayer]]) -> list[Box]:
    """Return the boxes that `composite_balls` changes in a frame of a shape (H, W, ...)."""
    boxes = [_shading_box(shape, layers) for layers in balls if layers]
    return [box for box in boxes if box is not None]


def _shading_box(shape: tuple[int, ...], layers: Sequence[SpriteLayer]) -> Box | None:
    """Return the box around a ball and its shadow, None outside the frame."""
    corners = [_patch_corner(layer) for layer in layers]
    return _bounding_box(shape, [layer.sprite.shading for layer in layers], corners, layers)


def _composite_shading(
    image: ImageArray, layers: Sequence[SpriteLayer], resting: Sequence[BallOutline], box: Box
) -> None:
    """Darken the background."""
    total: Float32Array | None = None
    for layer in layers:
        places = _thin_centres(layer.centres)
        for place in places:
            moved, weight = (
                _translate_patch(layer.sprite.shading, _patch_corner(layer) + place, box, cv2.INTER_LINEAR),
                layer.weight / len(places),
            )
            total = moved * np.float32(weight) if total is None else _add_weighted(total, moved, weight)
    assert total is not None
    uncovered = _mask_outside_balls(resting, box)
    total = total + 1 if uncovered is None else total * uncovered + 1
    ground = image[box[1] : box[3], box[0] : box[2]]
    ground[:] = cv2.multiply(ground, total, dtype=cv2.CV_8U)


def _add_weighted(total: Float32Array, patch: Float32Array, weight: float) -> Float32Array:
    """Return total + weight * patch."""
    return np.asarray(cv2.scaleAdd(patch, weight, total), dtype=np.float32)


def _composite_sprites(image: ImageArray, layers: Sequence[SpriteLayer], in_front: Sequence[BallOutline]) -> None:
    """Composite the layers of one ball behind the balls `in_front`."""
    corners = [_patch_corner(layer) + layer.sprite.rgba_offset for layer in layers]
    box = _bounding_box(image.shape, [layer.sprite.rgba for layer in layers], corners, layers)
    if box is None:
        return
    total = _average_layers(
        layers, [_sample_layer(layer, corner, box) for layer, corner in zip(layers, corners, strict=True)]
    )
    uncovered = _mask_outside_balls(in_front, box)
    total = total if uncovered is None else total * uncovered
    ground = image[box[1] : box[3], box[0] : box[2]]
    through = 1 - np.minimum(np.maximum(total[..., 3:], 0), 1)
    ground[:] = cv2.add(ground * through, np.ascontiguousarray(total[..., :3]), dtype=cv2.CV_8U)


def _average_layers(
    layers: Sequence[SpriteLayer], samples: Sequence[tuple[Float32Array, Float32Array | None]]
) -> Float32Array:
    """Return the mean colours and alpha (h, w, 4) of the layers, weighted by layer weight and visibility."""
    sum_of = sum(layer.weight for layer in layers)
    whole = min(1.0, sum_of)
    if all(visibility is None for _, visibility in samples):
        times = whole / max(sum_of, 1e-6)
        total = samples[0][0] * np.float32(layers[0].weight * times)
        for layer, (cover, _) in zip(layers[1:], samples[1:], strict=True):
            total = _add_weighted(total, cover, layer.weight * times)
        return total
    shares = [layer.weight if visibility is None else layer.weight * visibility[..., None]
              for layer, (_, visibility) in zip(layers, samples, strict=True)]  # fmt: skip
    by = whole / np.maximum(sum(shares), 1e-6)
    mixed = sum(cover * share for (cover, _), share in zip(samples, shares, strict=True)) * by
    return np.asarray(mixed, dtype=np.float32)


def _mask_outside_balls(balls: Sequence[BallOutline], box: Box) -> Float32Array | None:
    """Return a mask (h, w, 1), 0 on balls and 1 elsewhere; None without balls in the box."""
    x0, y0, x1, y1 = box
    mask: Float32Array | None = None
    for ball in balls:
        (x, y), reach = ball.centre, ball.reach
        if x0 - reach < x < x1 + reach and y0 - reach < y < y1 + reach:
            distance = ball.distance_to_path(x0, y0, x1 - x0, y1 - y0) - ball.radius
            outside: Float32Array = np.clip(distance / ball.edge_width, 0, 1)[..., None]
            mask = outside if mask is None else mask * outside
    return mask


def _sample_layer(layer: SpriteLayer, corner: FloatArray, box: Box) -> tuple[Float32Array, Float32Array | None]:
    """Return colours and alpha (h, w, 4) of a layer in a box, and its visibility (h, w); None: fully visible."""
    if layer.rotation is not None:
        return _sample_rotated_layer(layer, layer.rotation, corner, box)
    rgba = _translate_patch(layer.sprite.rgba, corner + layer.centres[0], box, cv2.INTER_CUBIC)
    for place in layer.centres[1:]:
        rgba += _translate_patch(layer.sprite.rgba, corner + place, box, cv2.INTER_CUBIC)
    if len(layer.centres) > 1:
        rgba /= np.float32(len(layer.centres))
    occlusion = layer.sprite.occlusion
    if occlusion is None:
        return rgba, None
    return rgba, 1 - _translate_patch(occlusion, corner + _mean_centre(layer.centres), box, cv2.INTER_LINEAR)


def _sample_rotated_layer(
    layer: SpriteLayer, rotation: RotationWarp, corner: FloatArray, box: Box
) -> tuple[Float32Array, Float32Array | None]:
    """Return the same for a layer whose markings rotate."""
    place = _mean_centre(layer.centres)
    shift = (np.array(box[:2]) - corner - place).astype(np.float32)
    first = place - (rotation.displacement.shape[0] - 1) / 2
    places = pixel_grid(box[3] - box[1], box[2] - box[0]) + shift
    where = places - _translate_patch(rotation.displacement, first, box, cv2.INTER_LINEAR)
    rgba = _remap_patch(layer.sprite.rgba, where, cv2.INTER_CUBIC)
    occlusion = layer.sprite.occlusion
    visibility = None if occlusion is None else 1 - _remap_patch(occlusion, where, cv2.INTER_LINEAR)
    if rotation.light_difference is not None:
        light = _translate_patch(rotation.light_difference, first, box, cv2.INTER_LINEAR)
        rgba[..., :3] = rotation.add_light(rgba[..., :3], light, rgba[..., 3:])
    if rotation.facing is not None:
        facing = 1 - _translate_patch(1 - rotation.facing, first, box, cv2.INTER_LINEAR)
        visibility = facing if visibility is None else visibility * facing
    if rotation.rotating_share is not None:
        inner = _translate_patch(rotation.rotating_share, first, box, cv2.INTER_LINEAR)
        unrotated = _remap_patch(layer.sprite.rgba, places, cv2.INTER_CUBIC)
        rgba = unrotated + (rgba - unrotated) * inner[..., None]
        uncovered = 1.0 if occlusion is None else 1 - _remap_patch(occlusion, places, cv2.INTER_LINEAR)
        visibility = (
            None if visibility is None else np.asarray(uncovered + (visibility - uncovered) * inner, dtype=np.float32)
        )
    return rgba, visibility


def _remap_patch(patch: Float32Array, where: Float32Array, flags: int) -> Float32Array:
    """Sample a patch at places `where` (h, w, 2) px."""
    return np.asarray(cv2.remap(patch, where, None, flags, borderMode=cv2.BORDER_CONSTANT), dtype=np.float32)


def _patch_corner(layer: SpriteLayer) -> FloatArray:
    """Return the first pixel (2,) of the shading relative to the ball's centre, px."""
    return np.array([layer.sprite.x, layer.sprite.y]) - layer.sprite.centre


def _thin_centres(centres: FloatArray) -> FloatArray:
    """Select at most `MAX_SHADING_CENTRES` of the places, evenly."""
    if len(centres) <= MAX_SHADING_CENTRES:
        return centres
    selected = np.linspace(0, len(centres) - 1, MAX_SHADING_CENTRES).round().astype(int)
    return np.asarray(centres[selected], dtype=np.float64)


def _bounding_box(
    shape: tuple[int, ...], patches: Sequence[Float32Array], corners: Sequence[FloatArray],
    layers: Sequence[SpriteLayer],
) -> Box | None:  # fmt: skip
    """Return the box around the patches at all places of their layers, cut at the border; None if it is empty."""
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for patch, corner, layer in zip(patches, corners, layers, strict=True):
        ends = layer.centres if len(layer.centres) == 1 else (layer.centres.min(axis=0), layer.centres.max(axis=0))
        (low_x, low_y), (high_x, high_y) = (corner + ends[0]).tolist(), (corner + ends[-1]).tolist()
        left, top = min(left, low_x), min(top, low_y)
        right, bottom = max(right, high_x + patch.shape[1]), max(bottom, high_y + patch.shape[0])
    x0, y0 = max(math.floor(left), 0), max(math.floor(top), 0)
    x1, y1 = min(math.ceil(right) + 1, shape[1]), min(math.ceil(bottom) + 1, shape[0])
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _translate_patch(patch: Float32Array, corner: FloatArray, box: Box, flags: int) -> Float32Array:
    """Resample a patch with its corner at a subpixel position into a box."""
    shift = np.array([[1.0, 0.0, corner[0] - box[0]], [0.0, 1.0, corner[1] - box[1]]])
    return np.asarray(cv2.warpAffine(patch, shift, (box[2] - box[0], box[3] - box[1]), flags=flags), dtype=np.float32)
