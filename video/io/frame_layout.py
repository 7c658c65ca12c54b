"""Decoded frames to upright images with square pixels, in the colours of a standard display."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np
from av.video.reformatter import Colorspace, Interpolation, VideoReformatter
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.io.colour_conversion import ColourConversion, expose_conversion, find_video_colours
from video.io.square_pixels import compute_square_size, stretch_to_square_pixels

# Deviation of the pixel aspect ratio from 1 that is applied: below, a ball of 20 px is 0.2 px wider than high, which is
# less than its outline is measured to, and resampling would blur it more.
LEAST_OBLONG_SHARE = 0.01
# Pixel aspect ratios that cameras and anamorphic lenses write (8:11 to 2); others are a damaged header.
ASPECT_RANGE = (0.25, 4.0)

# Least width or height, px, of video in BT.709 colours where nothing states them (as in mpv): standard definition,
# which is in BT.601, has at most 576 lines. FFmpeg takes BT.601 for all of it, which shifts greens by 20 levels.
HD_SIZE = (1280, 577)
# Matrix of frames without this tag (AVCOL_SPC_UNSPECIFIED).
UNSPECIFIED_MATRIX = 2
# 16-bit levels, which neither HLG nor PQ coarsens.
DEEP_FORMAT = "rgb48le"


@dataclass(frozen=True, slots=True)
class FrameOrientation:
    """How a stored frame is rotated upright: first columns and rows are swapped, then each is reversed."""

    swap: bool = False
    mirror_x: bool = False
    mirror_y: bool = False

    def rotate_upright(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Rotate a stored image (H, W[, 3]) upright."""
        if self == FrameOrientation():
            return image
        rotated = image.swapaxes(0, 1) if self.swap else image
        rotated = rotated[:, ::-1] if self.mirror_x else rotated
        return np.ascontiguousarray(rotated[::-1] if self.mirror_y else rotated)

    def rotate_places(self, places: FloatArray) -> FloatArray:
        """Rotate places (K, 2), in shares of width and height of a stored image, upright."""
        rotated = places[:, ::-1] if self.swap else places
        return np.where([self.mirror_x, self.mirror_y], 1 - rotated, rotated)


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """How the stored frames of a clip become images."""

    orientation: FrameOrientation
    aspect: Fraction
    """Width of a stored pixel over its height; 1 where they are used as stored."""
    colours: ColourConversion | None
    """Conversion to the colours of a standard display; None where they are that already."""
    matrix: Colorspace | None = None
    """Matrix from luma and chroma to RGB; None for that of the frame's tags."""

    def upright_size(self, frame: Any) -> tuple[int, int]:
        """Return width and height of the image of a frame, px."""
        width, height = self._square_size(frame)
        return (height, width) if self.orientation.swap else (width, height)

    @property
    def stored_scale(self) -> tuple[float, float]:
        """Stored pixels per pixel of the image, along x and y of the image."""
        x, y = min(1 / float(self.aspect), 1.0), min(float(self.aspect), 1.0)
        return (y, x) if self.orientation.swap else (x, y)

    def extract_rgb(self, frame: Any) -> ImageArray:
        """Convert a frame to an upright RGB image (H, W, 3)."""
        pixel_format = "rgb24" if self.colours is None else DEEP_FORMAT
        levels = _convert_frame(frame, pixel_format, self._square_size(frame), self.matrix)
        return self.orientation.rotate_upright(levels if self.colours is None else self.colours.convert(levels))

    def extract_luma(self, frame: Any) -> NDArray[np.uint8]:
        """Convert a frame to its upright luma (H, W), with the transfer curve of the video."""
        return self.orientation.rotate_upright(stretch_to_square_pixels(extract_stored_luma(frame), self.aspect))

    def _square_size(self, frame: Any) -> tuple[int, int]:
        """Return width and height of a frame with square pixels, px, not yet upright."""
        return compute_square_size(frame.width, frame.height, self.aspect)


# Frames used as stored.
STORED_LAYOUT = FrameLayout(FrameOrientation(), Fraction(1), None)


def read_layout(frame: Any, aspect: Fraction) -> FrameLayout:
    """Read how the frames of a clip become images.

    Call it for the first frame only: a frame whose side data was read is freed only by the garbage collector.

    Args:
        frame: the first frame.
        aspect: width of a pixel over its height, as stated.

    Returns:
        The layout of all frames.
    """
    is_oblong = abs(aspect - 1) > LEAST_OBLONG_SHARE and ASPECT_RANGE[0] <= aspect <= ASPECT_RANGE[1]
    is_hd, conversion = frame.width >= HD_SIZE[0] or frame.height >= HD_SIZE[1], None
    matrix = Colorspace.ITU709 if is_hd and frame.colorspace == UNSPECIFIED_MATRIX else None
    if colours := find_video_colours(frame):
        levels = _convert_frame(frame, DEEP_FORMAT, (frame.width, frame.height), matrix)
        conversion = expose_conversion(colours, levels)
    return FrameLayout(_read_orientation(frame), aspect if is_oblong else Fraction(1), conversion, matrix)


def _read_orientation(frame: Any) -> FrameOrientation:
    """Read the rotation and mirroring that the container requests, rounded to a quarter turn."""
    for data in frame.side_data:
        if data.type == av.sidedata.sidedata.Type.DISPLAYMATRIX:
            a, b, _, c, d = (int(v) for v in np.frombuffer(data, np.int32)[:5])
            swap = abs(a) < abs(b)
            return FrameOrientation(True, c < 0, b < 0) if swap else FrameOrientation(False, a < 0, d < 0)
    return FrameOrientation()


def _convert_frame(frame: Any, pixel_format: str, size: tuple[int, int], matrix: Colorspace | None = None) -> Any:
    """Convert a frame to an array of its own; `VideoFrame.reformat` would leave a converter in every kept frame."""
    is_resized = size != (frame.width, frame.height)
    converted = VideoReformatter().reformat(
        frame, *size, format=pixel_format, src_colorspace=matrix,
        interpolation=Interpolation.BICUBIC if is_resized else None, threads=1,
    )  # fmt: skip
    pixels = np.asarray(converted.to_ndarray())
    return pixels.copy() if converted is frame else pixels


def extract_stored_luma(frame: Any) -> NDArray[np.uint8]:
    """Copy the luma plane (H, W) as stored, in 8 bits; a colour conversion would cost more than the decoding."""
    depth = _luma_depth(frame.format)
    if depth is None:
        return np.asarray(_convert_frame(frame, "gray", (frame.width, frame.height)), np.uint8)
    plane = frame.planes[0]
    if depth == 8:
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
        return rows.copy()
    wide = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)[: frame.height, : frame.width]
    return (wide >> (depth - 8)).astype(np.uint8)


def _luma_depth(pixel_format: Any) -> int | None:
    """Bits per sample of plane 0 if it stores only luma in 8 or 16 bit words; None for every other layout."""
    luma_first = pixel_format.name.startswith(("yuv4", "yuva4", "yuvj4", "nv12", "nv21", "gray"))
    if not luma_first or pixel_format.is_big_endian or len(pixel_format.components) == 2 or pixel_format.is_bit_stream:
        return None
    depth = int(pixel_format.components[0].bits)
    return depth if 8 <= depth <= 16 else None
