"""Anti-aliased text and masks that are blended onto an image in one colour."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from models.core.typing import ByteArray, ImageArray
from models.numerics.jit import compile_kernel
from video.drawing.palette import Colour

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


@compile_kernel
def blend_colours(image: ImageArray, colours: ImageArray, cover: ByteArray, x: int, y: int, opacity: float) -> None:
    """Blend colours into an image through a mask, in place; parts outside the image are cut off.

    Args:
        image: Image (H, W, 3).
        colours: Colours (h, w, 3), or (1, 1, 3) for one colour everywhere.
        cover: Coverage (h, w), 0 to 255.
        x: Left pixel of the mask.
        y: Top pixel of the mask.
        opacity: Factor of the coverage, 0 to 1.
    """
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


def blend_mask(image: ImageArray, mask: ByteArray, x: int, y: int, colour: Colour, opacity: float = 1.0) -> None:
    """Paint a colour through a mask onto an image, in place.

    Args:
        image: Image (H, W, 3).
        mask: Coverage (h, w), 0 to 255; parts outside the image are cut.
        x: Left pixel of the mask.
        y: Top pixel of the mask.
        colour: Colour to paint.
        opacity: Factor of the coverage, 0 to 1.
    """
    blend_colours(image, np.array([[colour]], np.uint8), mask, x, y, float(opacity))


def draw_text(
    image: ImageArray,
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
