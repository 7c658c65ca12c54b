"""Streaked balls made sharp, so that they can be streaked anew along another way."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from models.core.typing import Float32Array, FloatArray
from video.matting.ball_matting import Sprite, taps_along

ROUNDS = 12
"""Of Richardson and Lucy: more bring out coding noise."""
GAINS = (0.6, 1.6)
"""How much darker and brighter a ball may be elsewhere on the table."""
LEAST_GROWTH = 0.02
"""Of a radius: less is not seen."""
SHARP = 1.0
"""px of streak below which a sprite is sharp."""


def streaked(patch: Float32Array, taps: FloatArray) -> Float32Array:
    """A patch (h, w, C) averaged over places (K, 2) px, of the same size."""
    made = cv2.filter2D(patch, cv2.CV_32F, _kernel(taps), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(made, dtype=np.float32).reshape(patch.shape)


def _kernel(taps: FloatArray) -> Float32Array:
    """The picture of a point that goes along the taps; turned round, as filter2D correlates."""
    half = int(np.ceil(np.abs(taps).max())) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.float32)
    whole = np.floor(-taps).astype(int)
    rest = -taps - whole
    for dy in (0, 1):
        for dx in (0, 1):
            weight = np.abs(1 - dx - rest[:, 0]) * np.abs(1 - dy - rest[:, 1])
            np.add.at(kernel, (whole[:, 1] + half + dy, whole[:, 0] + half + dx), weight)
    return kernel / np.float32(len(taps))


def sharpened(sprite: Sprite, radius: float) -> Sprite:
    """The ball as it would be seen with a short exposure (Richardson 1972, doi:10.1364/JOSA.62.000055; Lucy 1974).

    Colours times mask are what the shutter adds up, so these are what is undone; the ball is known to lie within its
    radius around the middle of its way.
    """
    if sprite.streak < SHARP:
        return sprite
    taps = taps_along(sprite.way)
    seen = np.maximum(sprite.cover, 0)
    disc = _disc(sprite, radius)
    level = np.maximum(seen.sum(axis=(0, 1)), 1e-3) / np.float32(max(float(disc.sum()), 1.0))
    guess: Float32Array = disc * level.astype(np.float32)
    for _ in range(ROUNDS):
        ratio = np.asarray(seen / np.maximum(streaked(guess, taps), 1e-3), dtype=np.float32)
        guess = np.asarray(guess * np.clip(streaked(ratio, -taps), 0.2, 5.0), dtype=np.float32)
    guess[..., 3] = np.minimum(disc[..., 0], 1)
    mask, ceiling = guess[..., 3:], 255 * guess[..., 3:]
    cover = np.concatenate([np.clip(guess[..., :3], 0, ceiling), mask], axis=2).astype(np.float32)
    return replace(sprite, cover=cover, seen=np.ones_like(sprite.seen), way=sprite.way[[len(sprite.way) // 2]] * 0)


def _disc(sprite: Sprite, radius: float) -> Float32Array:
    """(k, l, 1) the soft disc of the ball in the middle of its way."""
    height, width = sprite.cover.shape[:2]
    centre = sprite.centre - np.array([sprite.x, sprite.y]) - sprite.inset
    apart = np.hypot(np.arange(width)[None] - centre[0], np.arange(height)[:, None] - centre[1])
    edge = max(1.0, 0.1 * radius)
    return np.asarray(np.clip((radius + 1.5 * edge - apart) / edge, 0, 1)[..., None], dtype=np.float32)


def lit_like(sharp: Sprite, seen: Sprite) -> Sprite:
    """A sharp sprite in the light of another sighting, which may be streaked: one gain per colour."""
    here, there = (_totals(sprite) for sprite in (sharp, seen))
    gain = np.clip(there / np.maximum(here, 1e-3), *GAINS)
    cover = sharp.cover.copy()
    cover[..., :3] = np.minimum(cover[..., :3] * gain.astype(np.float32), 255 * np.clip(cover[..., 3:], 0, 1))
    return replace(sharp, cover=cover)


def _totals(sprite: Sprite) -> FloatArray:
    """(3,) mean colour of what was seen of a ball."""
    cover = sprite.cover * (sprite.seen > 0.5)[..., None]
    return np.asarray(cover[..., :3].sum(axis=(0, 1)) / max(float(cover[..., 3].sum()), 1e-3), dtype=np.float64)


def grown(sprite: Sprite, ratio: float) -> Sprite:
    """The ball `ratio` times as large, as it is seen nearer to the camera or further away."""
    if abs(ratio - 1) < LEAST_GROWTH:
        return sprite
    corner = (sprite.centre - np.array([sprite.x, sprite.y])) * ratio
    shade = _resized(sprite.shade, ratio)
    inset = np.rint(np.array(sprite.inset) * ratio)
    # whole pixels keep the parts together; what is left goes into the cover
    rest = np.array(sprite.inset) * ratio - inset
    cover, seen = (_resized(patch, ratio, rest) for patch in (sprite.cover, sprite.seen))
    return replace(
        sprite, x=0, y=0, centre=corner, shade=shade, cover=cover, seen=seen, inset=(int(inset[0]), int(inset[1]))
    )


def _resized(patch: Float32Array, ratio: float, shift: FloatArray | None = None) -> Float32Array:
    off = np.zeros(2) if shift is None else shift
    size = tuple(int(np.ceil(side * ratio)) + 1 for side in patch.shape[1::-1])
    grow = np.array([[ratio, 0, off[0]], [0, ratio, off[1]]])
    return np.asarray(cv2.warpAffine(patch, grow, size, flags=cv2.INTER_LINEAR), dtype=np.float32)
