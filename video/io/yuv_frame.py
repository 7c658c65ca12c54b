"""Frames in the planes of the encoder: Y', Cb and Cr of BT.709 in limited range, chroma at half size (YUV 4:2:0)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self, TypeVar

import cv2
import numpy as np

from models.core.srgb import LUMA_709
from models.core.typing import ByteArray, ImageArray

# (3, 4) red, green, blue and 1 to 8-bit Y', Cb and Cr in limited range (ITU-R BT.709-6, items 3.2 to 3.4).
# OpenCV rounds shares to 1 / 1024, which darkens by 0.054 levels in the mean, and halves of a mean of four upwards.
RGB_TO_YUV = np.column_stack([
    np.stack([
        219 * LUMA_709,
        112 * (np.eye(3)[2] - LUMA_709) / (1 - LUMA_709[2]),
        112 * (np.eye(3)[0] - LUMA_709) / (1 - LUMA_709[0]),
    ]) / 255,
    (16.054, 127.875, 127.875),
]).astype(np.float32)  # fmt: skip
_BACK = np.linalg.inv(RGB_TO_YUV[:, :3].astype(np.float64))
# (3, 4) the other way round.
YUV_TO_RGB = np.column_stack([_BACK, -_BACK @ np.array([16.0, 128.0, 128.0])]).astype(np.float32)


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
    def from_rgb(cls, rgb: ImageArray) -> Self:
        """Convert an image (H, W, 3); an odd side is made even by repeating its last column or row.

        Luma is right to 0.6 levels; the chroma of 2 x 2 pixels is their mean, to a level. FFmpeg's general converter is
        slower, and blurs chroma over four rows.
        """
        height, width = rgb.shape[:2]
        if height % 2 or width % 2:
            rgb = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        levels = convert_colours(rgb)
        halves = cv2.resize(levels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        bright, blue, red = (cv2.extractChannel(part, k) for k, part in enumerate((levels, halves, halves)))
        return cls((bright, blue, red))

    def mix(self, other: YuvFrame, share: float) -> Self:
        """Return the weighted mean of two frames of the same size; `share` is the weight of the other."""
        if share in (0.0, 1.0):
            bright, blue, red = (plane.copy() for plane in (self, other)[int(share)].planes)
        else:
            pairs = zip(self.planes, other.planes, strict=True)
            bright, blue, red = (cv2.addWeighted(one, 1 - share, more, share, 0) for one, more in pairs)
        return type(self)((bright, blue, red))

    def paste(self, rgb: ImageArray, x: int, y: int) -> None:
        """Replace a box, whose first pixel (x, y) is even, by an image (h, w, 3)."""
        for k, (plane, part) in enumerate(zip(self.planes, YuvFrame.from_rgb(rgb).planes, strict=True)):
            left, top = (x, y) if k == 0 else (x // 2, y // 2)
            plane[top : top + part.shape[0], left : left + part.shape[1]] = part

    def extend(self, rows: int, colour: tuple[int, int, int]) -> Self:
        """Return a copy with an even number of rows of a colour below it."""
        below = YuvFrame.from_rgb(np.full((rows, self.shape[1], 3), colour, np.uint8))
        bright, blue, red = (np.concatenate(pair) for pair in zip(self.planes, below.planes, strict=True))
        return type(self)((bright, blue, red))

    def crop_rows(self, rows: int) -> Self:
        """Return the upper `rows` rows, an even number; they share their memory with this frame."""
        bright, blue, red = self.planes
        return type(self)((bright[:rows], blue[: rows // 2], red[: rows // 2]))

    def copy_patch(self, x0: int, y0: int, x1: int, y1: int) -> ImageArray:
        """Copy the levels (y1 - y0, x1 - x0, 3) of a box inside the frame, each pixel with its chroma."""
        here = np.s_[y0 // 2 : (y1 + 1) // 2, x0 // 2 : (x1 + 1) // 2]
        inside = np.s_[y0 % 2 : y0 % 2 + y1 - y0, x0 % 2 : x0 % 2 + x1 - x0]
        chroma = (
            cv2.resize(plane[here], None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)[inside]
            for plane in self.planes[1:]
        )
        return np.asarray(cv2.merge([self.planes[0][y0:y1, x0:x1], *chroma]), dtype=np.uint8)

    def to_rgb(self, height: int, width: int) -> ImageArray:
        """Convert to an image (height, width, 3) of red, green and blue, without the row or column of an odd side."""
        return np.asarray(cv2.transform(self.copy_patch(0, 0, width, height), YUV_TO_RGB), dtype=np.uint8)


# What is drawn upon: an RGB image (H, W, 3), or a frame for the encoder.
Canvas = ImageArray | YuvFrame
# The same where a function returns what it was given.
Image = TypeVar("Image", ImageArray, YuvFrame, Canvas)


def convert_colours(rgb: ImageArray) -> ImageArray:
    """Convert colours (h, w, 3) from red, green and blue to Y', Cb and Cr of the same pixels."""
    return np.asarray(cv2.transform(rgb, RGB_TO_YUV), dtype=np.uint8)
