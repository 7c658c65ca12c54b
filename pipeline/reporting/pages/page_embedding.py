"""Embedding of images in a page."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image

from models.core.typing import ImageArray

JPEG_QUALITY = 82
MAX_IMAGE_PX = 1280
"""Longest side of an embedded image, px: phones load the page too."""


def embed_image_file(path: Path) -> str:
    """Encode an image file as the data URI of a JPEG."""
    with Image.open(path) as image:
        return build_jpeg_uri(np.asarray(image.convert("RGB")))


def build_jpeg_uri(pixels: ImageArray) -> str:
    """Encode an image (H, W, 3) as the data URI of a JPEG no larger than `MAX_IMAGE_PX`."""
    image, buffer = Image.fromarray(pixels), io.BytesIO()
    image.thumbnail((MAX_IMAGE_PX, MAX_IMAGE_PX))
    image.save(buffer, format="JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
