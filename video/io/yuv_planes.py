"""Conversion of RGB images to the planes of H.264: luma, and chroma at half the width and height (Y'CbCr 4:2:0)."""

from __future__ import annotations

from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, ImageArray
from video.io.pixel_kernels import fill_yuv_planes

BT709_LUMA_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""Luma weights of red, green and blue (ITU-R BT.709-6, item 3.2)."""
PIXEL_FORMAT = "yuv420p"


def _rgb_to_yuv_matrix() -> NDArray[np.float32]:
    """Return (3, 4): red, green, blue and 1 to 8-bit Y', Cb and Cr in limited range (BT.709-6, items 3.2 to 3.4).

    The chroma rows apply to the sum of four pixels.
    """
    bright = np.array(BT709_LUMA_WEIGHTS)
    blue, red = (np.eye(3)[k] - bright for k in (2, 0))
    of_four = 112 / 4
    shares = np.stack([219 * bright, of_four * blue / (1 - bright[2]), of_four * red / (1 - bright[0])]) / 255
    return np.column_stack([shares, [16.5, 128.5, 128.5]]).astype(np.float32)  # 0.5 rounds: conversion truncates


RGB_TO_YUV = _rgb_to_yuv_matrix()


def convert_to_yuv420(rgb: ImageArray) -> Any:
    """Convert an image to a frame for the encoder; the chroma of 2 x 2 pixels is their mean.

    Exact to half a level. FFmpeg's general converter is slower, and blurs chroma over four rows.

    Args:
        rgb: (H, W, 3) uint8, both sides even.

    Returns:
        An av.VideoFrame in yuv420p.
    """
    height, width = rgb.shape[:2]
    frame = av.VideoFrame(width, height, PIXEL_FORMAT)
    fill_yuv_planes(rgb, *(_plane_array(plane) for plane in frame.planes), RGB_TO_YUV)  # straight into the frame
    return frame


def _plane_array(plane: Any) -> ByteArray:
    """View a plane of a frame as a writable array (h, w)."""
    return np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
