"""Decoded frames to upright images with square pixels, in the colours of a standard display."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, Colorspace, ColorTrc, Interpolation, VideoReformatter
from numpy.typing import NDArray

from models.core.srgb import LUMA_709, decode_srgb, encode_srgb
from models.core.typing import ByteArray, Float32Array, FloatArray, ImageArray
from models.numerics.jit import compile_kernel
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

    def extract_chroma(self, frame: Any) -> NDArray[np.uint8]:
        """Convert a frame to its upright blue and red differences (H/2, W/2, 2), neutral at 128."""
        return self.orientation.rotate_upright(stretch_to_square_pixels(extract_stored_chroma(frame), self.aspect))

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


def extract_stored_chroma(frame: Any) -> NDArray[np.uint8]:
    """Copy the chroma planes (H/2, W/2, 2) in 8 bits; layouts that store others are converted."""
    if frame.format.name not in ("yuv420p", "yuvj420p"):
        frame = VideoReformatter().reformat(frame, frame.width, frame.height, format="yuv420p", threads=1)
    rows = [np.frombuffer(p, np.uint8).reshape(-1, p.line_size)[: p.height, : p.width] for p in frame.planes[1:3]]
    return np.stack(rows, axis=-1)


def _luma_depth(pixel_format: Any) -> int | None:
    """Bits per sample of plane 0 if it stores only luma in 8 or 16 bit words; None for every other layout."""
    luma_first = pixel_format.name.startswith(("yuv4", "yuva4", "yuvj4", "nv12", "nv21", "gray"))
    if not luma_first or pixel_format.is_big_endian or len(pixel_format.components) == 2 or pixel_format.is_bit_stream:
        return None
    depth = int(pixel_format.components[0].bits)
    return depth if 8 <= depth <= 16 else None


# cd/m^2 of the largest level of PQ, and of HLG on its reference display (BT.2100).
PQ_PEAK, HLG_PEAK = 10000.0, 1000.0
# Exponent of the luminance of a scene with which that display shows it (BT.2100).
HLG_GAMMA = 1.2
# Percentiles of the light of a frame that are the brightest highlight and a lit table, which fills a tenth of it.
WHITE_PERCENTILE, TABLE_PERCENTILE = 99.99, 90.0
# cd/m^2 of the least white: the first frame of a clip that fades from black is no measure.
LEAST_WHITE = 50.0
# Least light of the table relative to white; cloth reflects 10 to 30 % of the light. Beside a lamp or its reflection it
# is less, down to a hundredth, and would be black.
TABLE_LIGHT = 0.12
# Largest lift of dark parts: 40 raises light of 0.0034 to 0.12. Beyond, noise would be lifted.
MAX_LIFT = 40.0
# Levels of a 16-bit image, and entries of the tables.
LEVELS = 65536
# Chromaticities x, y of red, green and blue (BT.709, BT.2020, Display P3).
PRIMARIES = {
    ColorPrimaries.BT709: ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060)),
    ColorPrimaries.BT2020: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    ColorPrimaries.SMPTE432: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
WIDE_PRIMARIES = (ColorPrimaries.BT2020, ColorPrimaries.SMPTE432)
WIDE_GAMUT = "wide gamut"
# Chromaticity of their common white.
WHITE_D65 = (0.3127, 0.3290)


@dataclass(frozen=True, slots=True, eq=False)
class VideoColours:
    """What the levels of a video with other colours mean."""

    name: str
    """HLG, PQ or wide gamut."""
    light: Float32Array
    """(LEVELS,) light of each level, cd/m^2; relative to white for a wide gamut."""
    matrix: Float32Array
    """(3, 3) from the primaries of the video to those of BT.709."""
    power: float
    """Power of the luminance that multiplies the light."""

    def measure_light(self, image: Any) -> Float32Array:
        """Convert 16-bit levels (H, W, 3) to light (H, W, 3)."""
        light = np.empty(image.shape, np.float32)
        fill_light(image, self.light, self.matrix, self.power, light)
        return light


@dataclass(frozen=True, slots=True, eq=False)
class ColourConversion:
    """A conversion of 16-bit levels to 8-bit sRGB."""

    colours: VideoColours
    white: float = 1.0
    """Light that becomes the brightest level."""
    lift: float = 1.0
    """How much brighter dark parts become, see `fill_standard_colours`."""

    def convert(self, image: Any) -> ImageArray:
        """Convert an image (H, W, 3) of 16-bit levels to sRGB."""
        converted = np.empty(image.shape, np.uint8)
        light = self.colours.measure_light(image)
        fill_standard_colours(light, self.white, self.lift, _encoded_levels(), converted)
        return converted


def find_video_colours(frame: Any) -> VideoColours | None:
    """Find what the tags of a frame say of its colours; None for standard video."""
    if frame.color_trc in (ColorTrc.ARIB_STD_B67, ColorTrc.SMPTE2084) or frame.color_primaries in WIDE_PRIMARIES:
        return _build_colours(frame.color_trc, frame.color_primaries)
    return None


def expose_conversion(colours: VideoColours, image: Any) -> ColourConversion:
    """Choose white and lift from a 16-bit image (H, W, 3): what the levels of a camera call white is not fixed."""
    if colours.name == WIDE_GAMUT:
        return ColourConversion(colours)
    strongest = colours.measure_light(np.ascontiguousarray(image[::2, ::2])).max(axis=-1)
    white, table = (float(light) for light in np.percentile(strongest, (WHITE_PERCENTILE, TABLE_PERCENTILE)))
    white = max(white, LEAST_WHITE)
    share = max(table / white, 1e-6)
    lift = (TABLE_LIGHT - share**2) / (share * (1 - TABLE_LIGHT))  # such that the table is as bright as that
    return ColourConversion(colours, white, float(np.clip(lift, 1, MAX_LIFT)))


@lru_cache(maxsize=4)
def _build_colours(transfer: int, primaries: int) -> VideoColours:
    source = ColorPrimaries(primaries) if primaries in WIDE_PRIMARIES else ColorPrimaries.BT2020
    matrix = np.linalg.solve(_rgb_to_xyz(ColorPrimaries.BT709), _rgb_to_xyz(source)).astype(np.float32)
    level = np.arange(LEVELS) / (LEVELS - 1)
    if transfer == ColorTrc.ARIB_STD_B67:  # the light of the scene, times its luminance to the power of 0.2
        light = _decode_hlg(level) * HLG_PEAK ** (1 / HLG_GAMMA)
        return VideoColours("HLG", light.astype(np.float32), matrix, HLG_GAMMA - 1)
    if transfer == ColorTrc.SMPTE2084:
        return VideoColours("PQ", (PQ_PEAK * _decode_pq(level)).astype(np.float32), matrix, 0.0)
    return VideoColours(WIDE_GAMUT, decode_srgb(level).astype(np.float32), matrix, 0.0)


def _decode_hlg(level: FloatArray) -> FloatArray:
    """Return the light of HLG levels relative to the largest (BT.2100)."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * np.log(4 * a)
    return np.where(level <= 0.5, level**2 / 3, (np.exp((level - c) / a) + b) / 12)


def _decode_pq(level: FloatArray) -> FloatArray:
    """Return the light of PQ levels relative to the largest (BT.2100)."""
    m1, m2 = 2610 / 16384, 2523 / 32
    c1, c2, c3 = 3424 / 4096, 2413 / 128, 2392 / 128
    power = level ** (1 / m2)
    return np.asarray((np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1))


def _rgb_to_xyz(primaries: ColorPrimaries) -> FloatArray:
    """Return the matrix (3, 3) from linear light to CIE XYZ."""
    corners, white = (
        np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in places]).T for places in (PRIMARIES[primaries], [WHITE_D65])
    )
    return np.asarray(corners * np.linalg.solve(corners, white).T)


@lru_cache(maxsize=1)
def _encoded_levels() -> ByteArray:
    """Return (LEVELS,) the 8-bit sRGB level of linear light from 0 to 1."""
    return np.asarray(np.rint(255 * encode_srgb(np.arange(LEVELS) / (LEVELS - 1))), np.uint8)


@compile_kernel
def fill_standard_colours(
    light: Float32Array, white: float, lift: float, encoded: ByteArray, image: ImageArray
) -> None:
    """Convert light to the levels of a standard display.

    Light x of the strongest colour, relative to white, becomes x (lift + x) / (1 + lift x): with a lift of 1 it stays,
    with more, dark parts are brighter and highlights nearer to each other; hue and saturation stay (after Reinhard et
    al. 2002, doi:10.1145/566654.566575).

    Args:
        light: (H, W, 3) red, green and blue.
        white: light that becomes the brightest level.
        lift: at least 1.
        encoded: (n,) levels of light from 0 to 1.
        image: (H, W, 3) output.
    """
    one, most, last = np.float32(1), np.float32(lift), np.float32(len(encoded) - 1)
    share = one / np.float32(white)
    for j in range(light.shape[0]):
        for i in range(light.shape[1]):
            r, g, b = light[j, i, 0] * share, light[j, i, 1] * share, light[j, i, 2] * share
            strongest = max(r, g, b)
            gain = last * (most + strongest) / (one + most * strongest)
            image[j, i, 0] = encoded[np.intp(min(r * gain, last))]
            image[j, i, 1] = encoded[np.intp(min(g * gain, last))]
            image[j, i, 2] = encoded[np.intp(min(b * gain, last))]


@compile_kernel
def fill_light(
    image: NDArray[np.uint16], levels: Float32Array, matrix: Float32Array, power: float, light: Float32Array
) -> None:
    """Convert levels to the light that a display shows, in other primaries.

    Args:
        image: (H, W, 3) 16-bit levels.
        levels: (n,) light of each level.
        matrix: (3, 3) from its primaries to those of `light`; what these cannot show is cut off.
        power: power of the luminance that multiplies the light.
        light: (H, W, 3) output.
    """
    zero, exponent = np.float32(0), np.float32(power)
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            r, g, b = levels[image[j, i, 0]], levels[image[j, i, 1]], levels[image[j, i, 2]]
            for k in range(3):
                light[j, i, k] = max(matrix[k, 0] * r + matrix[k, 1] * g + matrix[k, 2] * b, zero)
            if exponent > zero:
                luminance = zero
                for k in range(3):
                    luminance += np.float32(LUMA_709[k]) * light[j, i, k]
                gain = luminance**exponent
                for k in range(3):
                    light[j, i, k] *= gain
