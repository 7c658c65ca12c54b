"""Discs and rings with fractions of a pixel, and the scale of drawings."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import Colour
from video.drawing.text import blend_mask

SHIFT = 4
"""Fractional bits of OpenCV's fixed-point coordinates."""


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


def disc_mask(centre: FloatArray, radius: float) -> tuple[ImageArray, int, int]:
    """Return the mask of a filled circle, and its top-left pixel."""
    half = int(np.ceil(radius + 2))
    x0, y0 = (int(v) for v in np.floor(centre) - half)
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    cv2.circle(
        mask, to_fixed_point(centre - [x0, y0]).tolist(), round(radius * (1 << SHIFT)), 255, -1, cv2.LINE_AA, SHIFT
    )
    return mask, x0, y0
