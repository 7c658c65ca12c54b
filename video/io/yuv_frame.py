"""Frames in the planes of the encoder: Y', Cb and Cr of BT.709 in limited range, chroma at half size (YUV 4:2:0)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self, TypeVar

import cv2
import numpy as np

from models.core.typing import ByteArray, Float32Array, ImageArray
from video.io.pixel_kernels import Box, copy_yuv, fill_blend, fill_yuv_planes

# Luma weights of red, green and blue (ITU-R BT.709-6, item 3.2).
BT709_LUMA_WEIGHTS = (0.2126, 0.7152, 0.0722)
# Levels of black (BT.709-6, item 3.4).
OFFSETS = (16.0, 128.0, 128.0)


def _rgb_to_yuv_matrix() -> Float32Array:
    """Return (3, 3): red, green and blue to 8-bit Y', Cb and Cr in limited range (BT.709-6, items 3.2 to 3.4)."""
    bright = np.array(BT709_LUMA_WEIGHTS)
    blue, red = (np.eye(3)[k] - bright for k in (2, 0))
    shares = np.stack([219 * bright, 112 * blue / (1 - bright[2]), 112 * red / (1 - bright[0])]) / 255
    return shares.astype(np.float32)


# (3, 4) red, green, blue and 1 to the levels of one pixel.
RGB_TO_YUV = np.column_stack([_rgb_to_yuv_matrix(), OFFSETS]).astype(np.float32)
# The same for `fill_yuv_planes`, which adds four pixels for chroma, and truncates: 0.5 rounds.
PLANE_SHARES = np.column_stack(
    [_rgb_to_yuv_matrix() / np.array([[1], [4], [4]], np.float32), np.add(OFFSETS, 0.5)]
).astype(np.float32)


@dataclass(frozen=True, slots=True)
class YuvFrame:
    """A frame whose planes are drawn upon and encoded as they are; both sides of it are even."""

    planes: tuple[ByteArray, ByteArray, ByteArray]
    """(H, W) luma, and twice (H / 2, W / 2) chroma, C-contiguous."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.planes[0].shape[0], self.planes[0].shape[1]

    @classmethod
    def allocate(cls, height: int, width: int) -> Self:
        """Allocate a frame without content of even height and width."""
        sizes = (height, width), (height // 2, width // 2), (height // 2, width // 2)
        bright, blue, red = (np.empty(size, np.uint8) for size in sizes)
        return cls((bright, blue, red))

    @classmethod
    def from_rgb(cls, rgb: ImageArray) -> Self:
        """Convert an image (H, W, 3); an odd side is made even by repeating its last column or row.

        Exact to half a level; the chroma of 2 x 2 pixels is their mean. FFmpeg's general converter is slower, and blurs
        chroma over four rows.
        """
        height, width = rgb.shape[:2]
        if height % 2 or width % 2:
            rgb = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        frame = cls.allocate(*rgb.shape[:2])
        frame.convert_box(np.ascontiguousarray(rgb), (0, 0, rgb.shape[1], rgb.shape[0]))
        return frame

    @classmethod
    def from_blend(cls, first: YuvFrame, second: YuvFrame, share: float) -> Self:
        """Return the weighted mean of two frames of the same size; `share` is the weight of the second."""
        if share in (0.0, 1.0):
            bright, blue, red = (plane.copy() for plane in (first, second)[int(share)].planes)
            return cls((bright, blue, red))
        frame = cls.allocate(*first.shape)
        for one, other, mixed in zip(first.planes, second.planes, frame.planes, strict=True):
            fill_blend(one.reshape(-1), other.reshape(-1), share, mixed.reshape(-1))
        return frame

    def convert_box(self, rgb: ImageArray, box: Box) -> None:
        """Take over a box (x0, y0, x1, y1, all even) of an image (H, W, 3) of the size of this frame."""
        fill_yuv_planes(rgb, *self.planes, PLANE_SHARES, box)

    def extend(self, rows: int, colour: ImageArray) -> Self:
        """Return a copy with an even number of rows of a colour (1, 1, 3), in levels of the planes, below it."""
        frame = type(self).allocate(self.shape[0] + rows, self.shape[1])
        for own, plane, level in zip(self.planes, frame.planes, colour.ravel().tolist(), strict=True):
            plane[: len(own)], plane[len(own) :] = own, level
        return frame

    def crop_rows(self, rows: int) -> Self:
        """Return the upper rows, an even number, which share their memory with this frame."""
        bright, blue, red = self.planes
        return type(self)((bright[:rows], blue[: rows // 2], red[: rows // 2]))

    def copy_patch(self, x0: int, y0: int, x1: int, y1: int) -> ImageArray:
        """Copy the levels (y1 - y0, x1 - x0, 3) of a box inside the frame, each pixel with its chroma."""
        patch = np.empty((max(y1 - y0, 0), max(x1 - x0, 0), 3), np.uint8)
        copy_yuv(*self.planes, x0, y0, patch)
        return patch


# What is drawn upon: an RGB image (H, W, 3), or a frame for the encoder.
Canvas = ImageArray | YuvFrame
# The same where a function returns what it was given.
Image = TypeVar("Image", ImageArray, YuvFrame)


def convert_colours(rgb: ImageArray) -> ImageArray:
    """Convert colours (h, w, 3) from red, green and blue to Y', Cb and Cr of the same pixels."""
    return np.asarray(cv2.transform(rgb, RGB_TO_YUV), dtype=np.uint8).reshape(rgb.shape)
