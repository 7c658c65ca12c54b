"""Sampling of a small part of an image in the geometry of a network's input."""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import ByteArray, FloatArray

MIN_ZOOM = 0.7
"""Zoom below which the image is first averaged over squares of whole pixels."""


def sample_patch(
    rgb: ByteArray, centre: FloatArray, linear: FloatArray, size: tuple[int, int], reach: float, zoom: float
) -> ByteArray:
    """Sample a patch of an image by a linear map.

    Args:
        rgb: Image (H, W, 3); its border is continued.
        centre: Px (2,) of the image at the middle of the patch.
        linear: Map (2, 2) from px of the image to px of the patch.
        size: Columns and rows of the patch.
        reach: Distance from the centre, px of the image, that the patch needs at most.
        zoom: Scale of the finer axis of `linear`, by which the averaging is chosen.

    Returns:
        The patch (rows, columns, 3).
    """
    part, shrunk, corner = _average_squares(rgb, centre, reach, zoom)
    # Px p of the image are (p + 1/2 - corner) / shrunk - 1/2 of the part.
    shift = linear @ (0.5 * shrunk - 0.5 + corner - centre)
    matrix = np.column_stack([linear * shrunk, shift + (np.array(size) - 1) / 2])
    shown = cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown, dtype=np.uint8)


def _average_squares(
    rgb: ByteArray, centre: FloatArray, reach: float, zoom: float
) -> tuple[ByteArray, int, FloatArray]:
    """Average the part of an image within a reach over squares; the part, the side of a square and its corner."""
    squares = round(1 / zoom) if zoom < MIN_ZOOM else 1
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
