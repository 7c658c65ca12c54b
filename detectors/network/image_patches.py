"""A small part of a picture brought to the form in which a network is shown it."""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import ByteArray, FloatArray

LEAST_ZOOM = 0.7
"""Pictures that would be shrunk further are averaged over whole pixels first."""


def patch(
    rgb: ByteArray, centre: FloatArray, linear: FloatArray, size: tuple[int, int], reach: float, zoom: float
) -> ByteArray:
    """A picture (H, W, 3) mapped by `linear` (2, 2), px `centre` (2,) in the middle of `size`, (columns, rows).

    Beyond its border the border goes on. Nothing farther than `reach` px is shown, and `zoom` is what the finer axis of
    the two is shrunk by.
    """
    part, shrunk, corner = _averaged(rgb, centre, reach, zoom)
    # Px p of the picture are (p + 1/2 - corner) / shrunk - 1/2 of the part.
    shift = linear @ (0.5 * shrunk - 0.5 + corner - centre)
    matrix = np.column_stack([linear * shrunk, shift + (np.array(size) - 1) / 2])
    shown = cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown, dtype=np.uint8)


def _averaged(rgb: ByteArray, centre: FloatArray, reach: float, zoom: float) -> tuple[ByteArray, int, FloatArray]:
    """The part of a picture within a reach, averaged over squares of so many px where it will be shrunk; its corner."""
    squares = round(1 / zoom) if zoom < LEAST_ZOOM else 1
    if squares == 1:
        return rgb, 1, np.zeros(2)
    height, width = rgb.shape[:2]
    half = int(np.ceil(reach)) + 2 * squares
    x0, y0 = (int(np.clip(c - half, 0, side - squares)) for c, side in zip(centre, (width, height), strict=True))
    across = max(min(x0 + 2 * half + 1, width) - x0, squares) // squares
    down = max(min(y0 + 2 * half + 1, height) - y0, squares) // squares
    part = rgb[y0 : y0 + down * squares, x0 : x0 + across * squares]
    small = cv2.resize(part, (across, down), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), squares, np.array([x0, y0], dtype=np.float64)
