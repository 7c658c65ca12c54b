"""Images whose pixels are not square, stretched; apart from decoding, as stills need no decoder."""

from __future__ import annotations

from fractions import Fraction

import cv2
import numpy as np
from numpy.typing import NDArray


def compute_square_size(width: int, height: int, aspect: Fraction) -> tuple[int, int]:
    """Compute width and height of an image with square pixels, px; no side gets shorter."""
    return round(width * max(aspect, Fraction(1))), round(height * max(1 / aspect, Fraction(1)))


def stretch_to_square_pixels(image: NDArray[np.uint8], aspect: Fraction) -> NDArray[np.uint8]:
    """Stretch an upright image (H, W[, 3]) whose pixels are `aspect` times as wide as high."""
    size = compute_square_size(image.shape[1], image.shape[0], aspect)
    if image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
