"""Chroma subsampling: cameras and codecs store one chroma value for every 2 x 2 pixels (4:2:0).

Decoded frames show it as squares on a fixed grid. Content that is moved by fractions of a pixel carries squares at
other places; synthetic frames would then differ from real ones wherever a saturated colour has an edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.io.pixel_kernels import average_chroma

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in px"""

LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Luma weights of RGB (BT.601); other standards differ by a few hundredths."""
MAX_ALIGNED_SHARE = 0.3
"""Largest deviation from the chroma of the own 2 x 2 block, relative to that on a shifted grid; rounding alone gives a
tenth."""
SAMPLED_ROW_STEP = 8
"""One of this many rows of blocks is examined."""


def has_subsampled_chroma(image: ImageArray) -> bool:
    """Check whether an image has one chroma value for every 2 x 2 pixels.

    Args:
        image: (H, W, 3) uint8 RGB.

    Returns:
        True for frames decoded from 4:2:0 video.
    """
    own, shifted = (_mean_chroma_deviation(part) for part in (image, image[1:, 1:]))
    return own < MAX_ALIGNED_SHARE * shifted


def _mean_chroma_deviation(image: ImageArray) -> float:
    """Mean difference (levels of 255) between the pixels of (H, W, 3) and the chroma of their 2 x 2 block."""
    height, width = (side // 2 * 2 for side in image.shape[:2])
    rows = image[:height, :width].reshape(height // 2, 2, width, 3)[::SAMPLED_ROW_STEP]
    sample = np.ascontiguousarray(rows).reshape(-1, width, 3)
    return float(cv2.absdiff(_average_block_chroma(sample), sample.astype(np.float32)).mean())


def _average_block_chroma(image: ImageArray) -> Float32Array:
    """Replace the chroma of (h, w, 3) by that of its 2 x 2 blocks, without rounding: half a level may matter."""
    height, width = image.shape[:2]
    bright = cv2.transform(image.astype(np.float32), LUMA_WEIGHTS[None])[..., None]
    colour = cv2.resize(image - bright, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(bright + cv2.resize(colour, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def subsample_chroma(image: ImageArray, box: Box) -> None:
    """Give every 2 x 2 pixels inside a box one chroma value, in place; the luma of each pixel is unchanged.

    Args:
        image: (H, W, 3) uint8 RGB, C-contiguous.
        box: x0, y0, x1, y1 in px; extended outwards to even borders, and cut at the image.
    """
    x0, y0 = (max(side, 0) // 2 * 2 for side in box[:2])
    x1, y1 = (min(-(-side // 2) * 2, whole // 2 * 2) for side, whole in zip(box[2:], image.shape[1::-1], strict=True))
    if x1 > x0 and y1 > y0:
        average_chroma(image, x0, y0, x1, y1, LUMA_WEIGHTS)
