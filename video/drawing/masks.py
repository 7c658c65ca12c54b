"""Masks of text, discs and rings, and colours that are blended onto an image through them."""

from __future__ import annotations

import math
import re
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from models.core.typing import ByteArray, FloatArray, ImageArray
from models.numerics.jit import compile_kernel
from video.drawing.palette import INK, Colour
from video.io.yuv_frame import Canvas, YuvFrame, convert_colours

# Distance of two lines over the font size.
LINE_SPACING = 1.4
# A space at which a line may end: not within a number with its error and unit.
_BREAK = re.compile(r"(?<![±=]) (?![±=%]|(?:m|mm|ms|s)\b)")
FONTS = Path(__file__).resolve().parent / "fonts"


@lru_cache(maxsize=32)
def _load_font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    """Load a font of a size in px."""
    return ImageFont.truetype(FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"), size)


@lru_cache(maxsize=1024)
def text_mask(text: str, size: int, bold: bool = False) -> ByteArray:
    """Render a line of text as a coverage mask.

    Args:
        text: Text to render.
        size: Font size, px.
        bold: Whether to use the bold font.

    Returns:
        Coverage (h, w), 0 to 255; the height depends on the font size alone. The mask is shared and read-only.
    """
    font = _load_font(size, bold)
    ascent, descent = font.getmetrics()
    image = Image.new("L", (max(1, int(np.ceil(font.getlength(text)))), ascent + descent))
    ImageDraw.Draw(image).text((0, 0), text, fill=255, font=font)
    mask = np.asarray(image, dtype=np.uint8)
    mask.setflags(write=False)
    return mask


def number_mask(text: str, size: int, bold: bool = False) -> ByteArray:
    """Render a number letter by letter at whole pixels, which is fast for numbers that change with every frame.

    Args:
        text: Digits and signs to render.
        size: Font size, px.
        bold: Whether to use the bold font.

    Returns:
        Coverage (h, w), 0 to 255.
    """
    ends = np.cumsum([_letter_advance(letter, size, bold) for letter in text])
    masks = [text_mask(letter, size, bold) for letter in text]
    starts = [0, *(round(float(end)) for end in ends[:-1])]
    whole = np.zeros((masks[0].shape[0], starts[-1] + masks[-1].shape[1]), dtype=np.uint8)
    for mask, start in zip(masks, starts, strict=True):
        part = whole[:, start : start + mask.shape[1]]
        np.maximum(part, mask[:, : part.shape[1]], out=part)
    return whole


@lru_cache(maxsize=256)
def _letter_advance(letter: str, size: int, bold: bool) -> float:
    """Return the distance from a letter to the next, px."""
    return float(_load_font(size, bold).getlength(letter))


@lru_cache(maxsize=64)
def round_corner_mask(width: int, height: int, radius: int) -> ByteArray:
    """Render a rectangle with round corners, anti-aliased by drawing at four times the size.

    Args:
        width: Width, px.
        height: Height, px.
        radius: Radius of the corners, px.

    Returns:
        Coverage (h, w), 0 to 255. The mask is shared and read-only.
    """
    image = Image.new("L", (width * 4, height * 4))
    ImageDraw.Draw(image).rounded_rectangle((0, 0, width * 4 - 1, height * 4 - 1), radius * 4, fill=255)
    mask = np.asarray(image.resize((width, height), Image.Resampling.BOX), dtype=np.uint8)
    mask.setflags(write=False)
    return mask


def blend_colours(image: Canvas, colours: ImageArray, cover: ByteArray, x: int, y: int, opacity: float = 1.0) -> None:
    """Blend colours into an image through a mask, in place; parts outside the image are cut off.

    Args:
        image: Image (H, W, 3), or frame for the encoder.
        colours: Colours (h, w, 3), or (1, 1, 3) for one colour everywhere.
        cover: Coverage (h, w), 0 to 255.
        x: Left pixel of the mask.
        y: Top pixel of the mask.
        opacity: Factor of the coverage, 0 to 1.
    """
    blend_levels(image, convert_colours(colours) if isinstance(image, YuvFrame) else colours, cover, x, y, opacity)


def blend_levels(image: Canvas, levels: ImageArray, cover: ByteArray, x: int, y: int, opacity: float = 1.0) -> None:
    """Blend as `blend_colours` does, but with colours in the colour space of the image."""
    if isinstance(image, YuvFrame):
        _blend_yuv(*image.planes, levels, cover, x, y, float(opacity))
    else:
        _blend_rgb(image, levels, cover, x, y, float(opacity))


@compile_kernel
def _blend_rgb(image: ImageArray, colours: ImageArray, cover: ByteArray, x: int, y: int, opacity: float) -> None:
    """Blend colours into an RGB image; the arguments are those of `blend_colours`."""
    rows, columns = image.shape[:2]
    step, half, most = np.intp(colours.shape[0] > 1), np.float32(0.5), np.float32(opacity / 255)
    for j in range(max(0, -y), min(cover.shape[0], rows - y)):
        for i in range(max(0, -x), min(cover.shape[1], columns - x)):
            if cover[j, i]:
                share = most * np.float32(cover[j, i])
                for k in range(3):
                    level = np.float32(image[y + j, x + i, k])
                    level += (np.float32(colours[step * j, step * i, k]) - level) * share
                    image[y + j, x + i, k] = np.uint8(np.int32(level + half))


@compile_kernel
def _blend_yuv(
    bright: ByteArray, blue: ByteArray, red: ByteArray, colours: ImageArray, cover: ByteArray, x: int, y: int,
    opacity: float,
) -> None:  # fmt: skip
    """Blend Y', Cb, Cr into the planes of a frame; chroma by the mean colour and the mean coverage of 2 x 2 pixels."""
    (rows, columns), (height, width), step = bright.shape, cover.shape, np.intp(colours.shape[0] > 1)
    half, quarter = np.float32(0.5), np.float32(0.25)
    most, fourth = np.float32(opacity / 255), np.float32(opacity / 1020)
    left, right = max(x, 0), min(x + width, columns)
    for v in range(max(y, 0), min(y + height, rows)):  # without branches, so that several pixels are computed at once
        line, mask, paint = bright[v, left:right], cover[v - y, left - x : right - x], colours[step * (v - y)]
        if step == 0:
            for n in range(len(line)):
                level = np.float32(line[n])
                level += (np.float32(paint[0, 0]) - level) * (most * np.float32(mask[n]))
                line[n] = np.uint8(np.int32(level + half))
        else:
            for n in range(len(line)):
                level = np.float32(line[n])
                level += (np.float32(paint[left - x + n, 0]) - level) * (most * np.float32(mask[n]))
                line[n] = np.uint8(np.int32(level + half))
    for j in range(max(y, 0) // 2, min((y + height + 1) // 2, rows // 2)):
        v, w = max(2 * j - y, 0), min(2 * j + 1 - y, height - 1)
        has_upper, has_lower = np.int32(2 * j >= y), np.int32(2 * j + 1 < y + height)
        upper, lower = cover[v], cover[w]
        for i in range(left // 2, min((x + width + 1) // 2, columns // 2)):
            u, t = max(2 * i - x, 0), min(2 * i + 1 - x, width - 1)
            whole = np.int32(2 * i >= x) * (has_upper * np.int32(upper[u]) + has_lower * np.int32(lower[u]))
            whole += np.int32(2 * i + 1 < x + width) * (has_upper * np.int32(upper[t]) + has_lower * np.int32(lower[t]))
            if whole > 0:
                share, a, b, c, d = fourth * np.float32(whole), step * v, step * w, step * u, step * t
                bluish = np.float32(colours[a, c, 1]) + np.float32(colours[a, d, 1])
                bluish += np.float32(colours[b, c, 1]) + np.float32(colours[b, d, 1])
                level = np.float32(blue[j, i])
                blue[j, i] = np.uint8(np.int32(level + (quarter * bluish - level) * share + half))
                reddish = np.float32(colours[a, c, 2]) + np.float32(colours[a, d, 2])
                reddish += np.float32(colours[b, c, 2]) + np.float32(colours[b, d, 2])
                level = np.float32(red[j, i])
                red[j, i] = np.uint8(np.int32(level + (quarter * reddish - level) * share + half))


def blend_mask(image: Canvas, mask: ByteArray, x: int, y: int, colour: Colour, opacity: float = 1.0) -> None:
    """Paint a colour through a mask onto an image, in place.

    Args:
        image: Image (H, W, 3).
        mask: Coverage (h, w), 0 to 255; parts outside the image are cut.
        x: Left pixel of the mask.
        y: Top pixel of the mask.
        colour: Colour to paint.
        opacity: Factor of the coverage, 0 to 1.
    """
    blend_levels(image, _convert_colour(colour, isinstance(image, YuvFrame)), mask, x, y, opacity)


@lru_cache(maxsize=256)
def _convert_colour(colour: Colour, is_yuv: bool) -> ImageArray:
    """Return a colour as levels (1, 1, 3) of an RGB image or of a frame for the encoder."""
    levels: ImageArray = np.array([[colour]], np.uint8)
    return convert_colours(levels) if is_yuv else levels


def draw_text(
    image: Canvas,
    text: str,
    x: float,
    y: float,
    size: int,
    colour: Colour,
    bold: bool = False,
    opacity: float = 1.0,
) -> int:
    """Draw a line of text onto an image, in place.

    Args:
        image: Image (H, W, 3).
        text: Text to draw.
        x: Left edge, px.
        y: Top edge, px.
        size: Font size, px.
        colour: Colour of the text.
        bold: Whether to use the bold font.

    Returns:
        Width of the text, px.
    """
    mask = text_mask(text, size, bold)
    blend_mask(image, mask, round(x), round(y), colour, opacity)
    return int(mask.shape[1])


def measure_panel(text: str, size: int) -> tuple[int, int]:
    """Measure width and height, px, of a text of a font size on its panel."""
    height, width = text_mask(text, size, bold=True).shape
    return width + 2 * (size // 3), height + 2


def draw_panel(
    image: ImageArray, text: str, middle: FloatArray, size: int, colour: Colour
) -> tuple[float, float, float, float]:
    """Draw a text on a dark panel around a point (2,), moved into the image; return left, top, width and height."""
    box = measure_panel(text, size)
    room = np.maximum(np.subtract(image.shape[1::-1], box), 0)
    left, top = (round(float(v)) for v in np.clip(middle - np.array(box) / 2, 0, room))
    blend_mask(image, round_corner_mask(*box, max(3, box[1] // 4)), left, top, INK, 0.72)
    draw_text(image, text, left + size // 3, top + 1, size, colour, bold=True)
    return float(left), float(top), float(box[0]), float(box[1])


def wrap_text(text: str, size: int, width: int, bold: bool = False) -> list[str]:
    """Break lines of text of a font size (px) so that they fit into `width` px."""
    font, lines = _load_font(size, bold), list[str]()
    for line in filter(None, text.splitlines()):
        first, *words = _BREAK.split(line)
        lines.append(first)
        for word in words:
            longer = f"{lines[-1]} {word}"
            lines = [*lines[:-1], longer] if font.getlength(longer) <= width else [*lines, word]
    return lines


def draw_paragraph(
    image: ImageArray, text: str, margin: int, y: int, size: int, colour: Colour, bold: bool = False
) -> int:
    """Draw text in as many lines as it needs, in place.

    Args:
        image: Image (H, W, 3).
        text: One or several lines.
        margin: px left and right of the text.
        y: Top edge, px.
        size: Font size, px.
        colour: Colour of the text.
        bold: Whether to use the bold font.

    Returns:
        Top edge of what follows, px.
    """
    for line in wrap_text(text, size, image.shape[1] - 2 * margin, bold):
        draw_text(image, line, margin, y, size, colour, bold)
        y += round(LINE_SPACING * size)
    return y


# Fractional bits of OpenCV's fixed-point coordinates.
SHIFT = 4


def drawing_scale(height: int) -> float:
    """Return the scale of drawings relative to a frame of 720 rows; small frames keep legible text."""
    return max(height / 720, 0.78)


def to_fixed_point(px: FloatArray) -> NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed-point coordinates."""
    return np.asarray(np.rint(px * (1 << SHIFT)), dtype=np.int32)


def draw_ring(
    image: Canvas,
    centre: FloatArray,
    radius: float,
    thickness: float,
    colour: Colour,
    opacity: float,
    dashes: int = 0,
) -> None:
    """Draw a circle, solid or dashed, in place."""
    if not np.isfinite(centre).all() or opacity <= 0.01:
        return
    half = int(np.ceil(radius + thickness + 2))
    x0, y0 = (int(v) for v in np.floor(centre) - half)
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    middle = to_fixed_point(centre - [x0, y0]).tolist()
    size = round(radius * (1 << SHIFT))
    stroke = max(1, round(thickness))
    if dashes:
        step = 360 / dashes
        for dash in range(dashes):
            start = dash * step
            cv2.ellipse(mask, middle, (size, size), 0, start, start + 0.5 * step, 255, stroke, cv2.LINE_AA, SHIFT)
    else:
        cv2.circle(mask, middle, size, 255, stroke, cv2.LINE_AA, SHIFT)
    blend_mask(image, mask, x0, y0, colour, opacity)


def draw_disc(image: Canvas, centre: FloatArray, radius: float, colour: Colour, opacity: float = 1.0) -> None:
    """Draw a filled circle, in place."""
    mask, x, y = disc_mask(centre, radius)
    blend_mask(image, mask, x, y, colour, opacity)


def disc_mask(centre: FloatArray, radius: float) -> tuple[ByteArray, int, int]:
    """Return the mask of a filled circle, and its top-left pixel."""
    half = math.ceil(radius + 2)
    x, y = (round(float(place) * (1 << SHIFT)) for place in centre)
    within = (1 << SHIFT) - 1
    return (
        _disc_cover(half, x & within, y & within, round(radius * (1 << SHIFT))),
        (x >> SHIFT) - half,
        (y >> SHIFT) - half,
    )


@lru_cache(maxsize=4096)
def _disc_cover(half: int, x: int, y: int, radius: int) -> ByteArray:
    """Return the mask of a disc around a fraction (x, y) of pixel (half, half), in fixed-point px.

    Cached, shared and read-only: most balls rest, and the others take up the same fractions of a pixel again.
    """
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    cv2.circle(mask, ((half << SHIFT) + x, (half << SHIFT) + y), radius, 255, -1, cv2.LINE_AA, SHIFT)
    mask.setflags(write=False)
    return mask
