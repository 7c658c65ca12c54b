"""Deblurring of streaked balls, and adjustment of sharp balls to another light, size and streak."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from models.core.typing import Float32Array, FloatArray
from video.matting.ball_matting import MattedSprite, sample_path

# Richardson-Lucy iterations; more amplify coding noise.
ITERATIONS = 12
# Limits of the brightness ratio of a ball between two places on the table.
GAIN_LIMITS = (0.6, 1.6)
# Relative change of the radius below which a sprite is not scaled.
MIN_SCALE_CHANGE = 0.02
# px of streak below which a sprite is sharp.
MAX_SHARP_STREAK_PX = 1.0


def blur_along_path(patch: Float32Array, places: FloatArray) -> Float32Array:
    """Average a patch (h, w, C) over places (K, 2) px, keeping its size."""
    blurred = cv2.filter2D(patch, cv2.CV_32F, _path_kernel(places), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32).reshape(patch.shape)


def _path_kernel(places: FloatArray) -> Float32Array:
    """Return the image of a point moving along the places, mirrored because filter2D correlates."""
    half = int(np.ceil(np.abs(places).max())) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.float32)
    whole = np.floor(-places).astype(int)
    rest = -places - whole
    for dy in (0, 1):
        for dx in (0, 1):
            weight = np.abs(1 - dx - rest[:, 0]) * np.abs(1 - dy - rest[:, 1])
            np.add.at(kernel, (whole[:, 1] + half + dy, whole[:, 0] + half + dx), weight)
    return kernel / np.float32(len(places))


def deblur_sprite(sprite: MattedSprite, radius: float) -> MattedSprite:
    """Estimate the ball at a short shutter time (Richardson 1972, doi:10.1364/JOSA.62.000055; Lucy 1974).

    The shutter sums premultiplied colours, so these are deconvolved. The ball is constrained to lie within its radius
    around the middle of its path.
    """
    if sprite.streak_length < MAX_SHARP_STREAK_PX:
        return sprite
    places = sample_path(sprite.path)
    observed = np.maximum(sprite.rgba, 0)
    disc = _ball_disc(sprite, radius)
    level = np.maximum(observed.sum(axis=(0, 1)), 1e-3) / np.float32(max(float(disc.sum()), 1.0))
    guess: Float32Array = disc * level.astype(np.float32)
    for _ in range(ITERATIONS):
        ratio = np.asarray(observed / np.maximum(blur_along_path(guess, places), 1e-3), dtype=np.float32)
        guess = np.asarray(guess * np.clip(blur_along_path(ratio, -places), 0.2, 5.0), dtype=np.float32)
    guess[..., 3] = np.minimum(disc[..., 0], 1)
    mask, ceiling = guess[..., 3:], 255 * guess[..., 3:]
    rgba = np.concatenate([np.clip(guess[..., :3], 0, ceiling), mask], axis=2).astype(np.float32)
    return replace(
        sprite, rgba=rgba, visibility=np.ones_like(sprite.visibility), path=sprite.path[[len(sprite.path) // 2]] * 0
    )


def _ball_disc(sprite: MattedSprite, radius: float) -> Float32Array:
    """Return the soft disc (k, l, 1) of the ball at the middle of its path."""
    height, width = sprite.rgba.shape[:2]
    centre = sprite.centre - np.array([sprite.x, sprite.y]) - sprite.rgba_offset
    distance = np.hypot(np.arange(width)[None] - centre[0], np.arange(height)[:, None] - centre[1])
    edge = max(1.0, 0.1 * radius)
    return np.asarray(np.clip((radius + 1.5 * edge - distance) / edge, 0, 1)[..., None], dtype=np.float32)


def match_brightness(sharp: MattedSprite, reference: MattedSprite) -> MattedSprite:
    """Scale each colour channel of a sharp sprite to the mean colour of another view, which may be streaked."""
    own, target = (_mean_colour(sprite) for sprite in (sharp, reference))
    gain = np.clip(target / np.maximum(own, 1e-3), *GAIN_LIMITS)
    rgba = sharp.rgba.copy()
    rgba[..., :3] = np.minimum(rgba[..., :3] * gain.astype(np.float32), 255 * np.clip(rgba[..., 3:], 0, 1))
    return replace(sharp, rgba=rgba)


def _mean_colour(sprite: MattedSprite) -> FloatArray:
    """Return the mean colour (3,) of the visible part of a ball."""
    rgba = sprite.rgba * (sprite.visibility > 0.5)[..., None]
    return np.asarray(rgba[..., :3].sum(axis=(0, 1)) / max(float(rgba[..., 3].sum()), 1e-3), dtype=np.float64)


def scale_sprite(sprite: MattedSprite, ratio: float) -> MattedSprite:
    """Scale a ball by a ratio, for a view from another distance."""
    if abs(ratio - 1) < MIN_SCALE_CHANGE:
        return sprite
    corner = (sprite.centre - np.array([sprite.x, sprite.y])) * ratio
    shading = _scale_patch(sprite.shading, ratio)
    offset = np.rint(np.array(sprite.rgba_offset) * ratio)
    # Whole-pixel offsets keep both patches aligned; the fraction shifts the colours.
    rest = np.array(sprite.rgba_offset) * ratio - offset
    rgba, visibility = (_scale_patch(patch, ratio, rest) for patch in (sprite.rgba, sprite.visibility))
    return replace(
        sprite, x=0, y=0, centre=corner, shading=shading, rgba=rgba, visibility=visibility,
        rgba_offset=(int(offset[0]), int(offset[1])),
    )  # fmt: skip


def _scale_patch(patch: Float32Array, ratio: float, shift: FloatArray | None = None) -> Float32Array:
    """Scale a patch by a ratio, shifted by a fraction of a pixel."""
    off = np.zeros(2) if shift is None else shift
    size = tuple(int(np.ceil(side * ratio)) + 1 for side in patch.shape[1::-1])
    grow = np.array([[ratio, 0, off[0]], [0, ratio, off[1]]])
    return np.asarray(cv2.warpAffine(patch, grow, size, flags=cv2.INTER_LINEAR), dtype=np.float32)
