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
    layers = [cut_squares(image.luma, _follow(shift, place), PATCH_PX) for image, shift in pairs]
    near = window.images[MIDDLE_IMAGE - 1 : MIDDLE_IMAGE + 2]
    for image in near:
        height, width = image.chroma.shape[:2]
        # By 2 exactly, as chroma is: other shares move places, and take twenty times as long.
        half = cv2.resize(image.luma[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        layers.append(cut_squares(np.asarray(half, np.uint8), place // 2, PATCH_PX))
    colours = [cut_squares(image.chroma, place // 2, PATCH_PX) for image in near]
    return np.concatenate([np.stack(layers, axis=1), *colours], axis=1)


def _follow(shift: FloatArray, place: IntArray) -> IntArray:
    """Find the px (K, 2) of a neighbour that show what is at places of the frame, were it still."""
    if np.array_equal(shift, np.eye(3)):
        return place
    return np.asarray(np.round(apply_homography(shift, place.astype(np.float64))), np.int64)


def cut_squares(image: ByteArray, place: IntArray, side: int) -> ByteArray:
    """Cut squares (K, [2,] side, side) of an even side about places (K, 2); the border of the image is continued."""
    # Squares of a wider image are copied row by row: indices of every px take three times as long.
    wide = cv2.copyMakeBorder(image, side, side, side, side, cv2.BORDER_REPLICATE)
    squares = np.lib.stride_tricks.sliding_window_view(wide, (side, side), axis=(0, 1))
    x, y = np.clip(place + side // 2, 0, np.array(squares.shape[1::-1]) - 1).T
    return np.asarray(squares[y, x])
