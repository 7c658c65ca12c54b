"""What the network sees of a spot: the frame and its neighbours about it, near and in its wider surroundings."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.flying.frame_windows import MIDDLE_IMAGE, FrameWindow
from models.core.scene import apply_homography
from models.core.typing import ByteArray, FloatArray, IntArray

# Side of a patch, px; its layers of luma: seven frames, and three of them reduced to half; all, with the chroma of
# these three; and those of the frame's own luma and chroma.
PATCH_PX, LUMA_LAYERS, LAYERS = 32, 10, 16
FRAME_LUMA, FRAME_CHROMA = slice(3, 4), slice(12, 14)
# px of a patch before its spot.
MIDDLE = PATCH_PX // 2


def cut_patches(window: FrameWindow, place: IntArray) -> ByteArray:
    """Cut the surroundings of spots.

    Args:
        window: A frame and its neighbours.
        place: (K, 2) x and y, working px.

    Returns:
        (K, 16, 32, 32): the luma of the seven images in px, then the luma and after it the chroma of the frame and its
        nearest neighbours in steps of two px, in the order of time; the spot is at (16, 16), and at the px of (16, 16)
        of the reduced ones.
    """
    pairs = zip(window.images, window.shifts, strict=True)
    layers = [_gather(image.luma, _follow(shift, place)) for image, shift in pairs]
    near = window.images[MIDDLE_IMAGE - 1 : MIDDLE_IMAGE + 2]
    for image in near:
        half = cv2.resize(image.luma, image.chroma.shape[1::-1], interpolation=cv2.INTER_AREA)
        layers.append(_gather(np.asarray(half, np.uint8), place // 2))
    colours = [np.moveaxis(_gather(image.chroma, place // 2), 3, 1) for image in near]
    return np.concatenate([np.stack(layers, axis=1), *colours], axis=1)


def _follow(shift: FloatArray, place: IntArray) -> IntArray:
    """Find the px (K, 2) of a neighbour that show what is at places of the frame, were it still."""
    if np.array_equal(shift, np.eye(3)):
        return place
    return np.asarray(np.round(apply_homography(shift, place.astype(np.float64))), np.int64)


def _gather(image: ByteArray, place: IntArray) -> ByteArray:
    """Cut squares (K, 32, 32[, 2]) about places; the border of the image is continued."""
    steps = np.arange(PATCH_PX) - MIDDLE
    rows = np.clip(place[:, 1, None] + steps, 0, image.shape[0] - 1)
    columns = np.clip(place[:, 0, None] + steps, 0, image.shape[1] - 1)
    return np.asarray(image[rows[:, :, None], columns[:, None, :]])
