"""Image files: those that a user gives, read as upright RGB, and those of results."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from models.core.errors import ClipError, OptionError
from models.core.typing import ImageArray
from pipeline.engine.atomic_write import replace_file
from video.io.square_pixels import stretch_to_square_pixels

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


class UnreadableImage(OptionError):
    """The file is no readable image."""


def read_image(path: Path, aspect: Fraction | None = None) -> ImageArray:
    """Read an image file.

    Args:
        path: A png, jpg, bmp, tif or webp file.
        aspect: Width of its pixels over their height; None for 1.

    Returns:
        Upright RGB image with square pixels, (height, width, 3).

    Raises:
        UnreadableImage: The file is missing, empty or no image.
    """
    data = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if decoded is None:
        raise UnreadableImage(f"{path.name} is no readable image ({', '.join(IMAGE_SUFFIXES)} are)")
    image = np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    return image if aspect is None else stretch_to_square_pixels(image, aspect)


def write_image(image: ImageArray, path: Path) -> None:
    """Write an image in one step.

    Args:
        image: (H, W, 3) RGB.
        path: File to write; its suffix names the format.

    Raises:
        ClipError: The image cannot be encoded.
    """
    is_encoded, data = cv2.imencode(path.suffix.lower(), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not is_encoded:
        height, width = image.shape[:2]
        raise ClipError(f"{path.name} was to be an image of {width} x {height} px; it failed")
    with replace_file(path) as target:
        target.write_bytes(data.tobytes())
