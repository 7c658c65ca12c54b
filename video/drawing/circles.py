"""Discs and rings with fractions of a pixel, and the scale of drawings."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, FloatArray, ImageArray
from video.drawing.palette import Colour
from video.drawing.text import blend_mask

# Fractional bits of OpenCV's fixed-point coordinates.
SHIFT = 4


def drawing_scale(height: int) -> float:
    """Return the scale of drawings relative to a frame of 720 rows; small frames keep legible text."""
    return max(height / 720, 0.78)


def to_fixed_point(px: FloatArray) -> NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed-point coordinates."""
    return np.asarray(np.rint(px * (1 << SHIFT)), dtype=np.int32)


def draw_ring(
    image: ImageArray,
    centre: FloatArray,
    radius: float,
    thickness: float,
    colour: Colour,
    opacity: float,
    dashes: int = 0,
) -> None:
    """Draw a circle, solid or dashed, in place."""
    if not np.isfinite(centre).all() or opacity <= 0.01:
        return
    half = int(np.ceil(radius + thickness + 2))
    x0, y0 = (int(v) for v in np.floor(centre) - half)
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    middle = to_fixed_point(centre - [x0, y0]).tolist()
    size = round(radius * (1 << SHIFT))
    stroke = max(1, round(thickness))
    if dashes:
        step = 360 / dashes
        for dash in range(dashes):
            start = dash * step
            cv2.ellipse(mask, middle, (size, size), 0, start, start + 0.5 * step, 255, stroke, cv2.LINE_AA, SHIFT)
    else:
        cv2.circle(mask, middle, size, 255, stroke, cv2.LINE_AA, SHIFT)
    blend_mask(image, mask, x0, y0, colour, opacity)


def draw_disc(image: ImageArray, centre: FloatArray, radius: float, colour: Colour, opacity: float = 1.0) -> None:
    """Draw a filled circle, in place."""
    mask, x, y = disc_mask(centre, radius)
    blend_mask(image, mask, x, y, colour, opacity)


def disc_mask(centre: FloatArray, radius: float) -> tuple[ByteArray, int, int]:
    """Return the mask of a filled circle, and its top-left pixel."""
    half = math.ceil(radius + 2)
    x, y = (round(float(place) * (1 << SHIFT)) for place in centre)
    within = (1 << SHIFT) - 1
    return (
        _disc_cover(half, x & within, y & within, round(radius * (1 << SHIFT))),
        (x >> SHIFT) - half,
        (y >> SHIFT) - half,
    )


@lru_cache(maxsize=4096)
def _disc_cover(half: int, x: int, y: int, radius: int) -> ByteArray:
    """Return the mask of a disc around a fraction (x, y) of pixel (half, half), in fixed-point px.

    Cached, shared and read-only: most balls rest, and the others take up the same fractions of a pixel again.
    """
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    cv2.circle(mask, ((half << SHIFT) + x, (half << SHIFT) + y), radius, 255, -1, cv2.LINE_AA, SHIFT)
    mask.setflags(write=False)
    return mask
