"""The coarse colours of video: cameras and codecs keep one colour, less its brightness, for every two by two pixels.

Decoded pictures show it as squares on a fixed grid. What is moved over them by parts of a pixel carries squares of its
own that lie otherwise; made pictures then differ from real ones wherever a bright colour has an edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.io.pixel_kernels import square

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1"""

LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Brightness of RGB (BT.601); what another standard adds is a few hundredths."""
ALIGNED = 0.3
"""Times as much as from squares on a shifted grid that pixels may differ from their own: rounding is a tenth."""
SAMPLED = 8
"""One of so many rows of squares is looked at."""


def has_squares(picture: ImageArray) -> bool:
    """Whether a picture (H, W, 3) has one colour for every two by two pixels."""
    own, shifted = (_apart(part) for part in (picture, picture[1:, 1:]))
    return own < ALIGNED * shifted


def _apart(picture: ImageArray) -> float:
    """Levels of 255 by which pixels of (H, W, 3) differ from the colour of their square, on average."""
    height, width = (side // 2 * 2 for side in picture.shape[:2])
    rows = picture[:height, :width].reshape(height // 2, 2, width, 3)[::SAMPLED]
    sample = np.ascontiguousarray(rows).reshape(-1, width, 3)
    return float(cv2.absdiff(_squared(sample), sample.astype(np.float32)).mean())


def _squared(picture: ImageArray) -> Float32Array:
    """The same (h, w, 3) with the colour of each square, not rounded: what tells squares apart may be half a level."""
    height, width = picture.shape[:2]
    bright = cv2.transform(picture.astype(np.float32), LUMA[None])[..., None]
    colour = cv2.resize(picture - bright, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(bright + cv2.resize(colour, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def square_colours(picture: ImageArray, box: Box) -> None:
    """Give every 2 x 2 pixels of a box of `picture` (H, W, 3), in one piece, one colour, in place; brightness stays."""
    x0, y0 = (max(side, 0) // 2 * 2 for side in box[:2])
    x1, y1 = (min(-(-side // 2) * 2, whole // 2 * 2) for side, whole in zip(box[2:], picture.shape[1::-1], strict=True))
    if x1 > x0 and y1 > y0:
        square(picture, x0, y0, x1, y1, LUMA)
