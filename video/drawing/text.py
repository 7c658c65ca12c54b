"""Anti-aliased text, and masks laid over pictures in a colour."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from models.core.typing import ByteArray, ImageArray
from video.drawing.palette import Colour
from video.io.pixel_kernels import paint, paint_where

FONTS = Path(__file__).resolve().parent / "fonts"


@lru_cache(maxsize=32)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"), size)


@lru_cache(maxsize=1024)
def text_mask(text: str, size: int, bold: bool = False) -> ByteArray:
    """Coverage (h, w) of a line of text, 0 to 255; the height is the font's, whatever the letters.

    `size` is the font size in px. The mask is shared: do not write into it.
    """
    font = _font(size, bold)
    ascent, descent = font.getmetrics()
    image = Image.new("L", (max(1, int(np.ceil(font.getlength(text)))), ascent + descent))
    ImageDraw.Draw(image).text((0, 0), text, fill=255, font=font)
    mask = np.asarray(image, dtype=np.uint8)
    mask.setflags(write=False)
    return mask


def number_mask(text: str, size: int, bold: bool = False) -> ByteArray:
    """As `text_mask`, put together from its letters at whole pixels: for numbers that change with every picture."""
    ends = np.cumsum([_advance(letter, size, bold) for letter in text])
    masks = [text_mask(letter, size, bold) for letter in text]
    starts = [0, *(round(float(end)) for end in ends[:-1])]
    whole = np.zeros((masks[0].shape[0], starts[-1] + masks[-1].shape[1]), dtype=np.uint8)
    for mask, start in zip(masks, starts, strict=True):
        part = whole[:, start : start + mask.shape[1]]
        np.maximum(part, mask[:, : part.shape[1]], out=part)
    return whole


@lru_cache(maxsize=256)
def _advance(letter: str, size: int, bold: bool) -> float:
    """px from a letter to the next."""
    return float(_font(size, bold).getlength(letter))


@lru_cache(maxsize=64)
def rounded_mask(width: int, height: int, radius: int) -> ByteArray:
    """Coverage (h, w) of a rectangle with round corners, drawn at four times its size; do not write into it."""
    image = Image.new("L", (width * 4, height * 4))
    ImageDraw.Draw(image).rounded_rectangle((0, 0, width * 4 - 1, height * 4 - 1), radius * 4, fill=255)
    mask = np.asarray(image.resize((width, height), Image.Resampling.BOX), dtype=np.uint8)
    mask.setflags(write=False)
    return mask


def lay(picture: ImageArray, mask: ByteArray, x: int, y: int, colour: Colour, opacity: float = 1.0) -> None:
    """Paint `colour` through `mask` (h, w) with its top-left pixel at (x, y), in place; what is outside is cut."""
    if opacity > 0:
        paint(picture, mask, x, y, colour, float(opacity))


def lay_sparse(
    picture: ImageArray, layers: Sequence[tuple[ByteArray, Colour]], x: int, y: int, free: ByteArray
) -> None:
    """As `lay`, one layer upon the other where the picture is `free` (H, W; 0 to 255), touching covered pixels alone.

    For large masks that are mostly empty, lie inside the picture, and cover no more than the first of them.
    """
    found = cv2.findNonZero(layers[0][0])
    if found is not None:
        masks, colours = zip(*layers, strict=True)
        paint_where(picture, found.reshape(-1, 2), masks, x, y, colours, free)


def write(
    picture: ImageArray,
    text: str,
    x: float,
    y: float,
    size: int,
    colour: Colour,
    bold: bool = False,
    opacity: float = 1.0,
) -> int:
    """Write a line with its top-left corner at (x, y), in place; returns its width in px."""
    mask = text_mask(text, size, bold)
    lay(picture, mask, round(x), round(y), colour, opacity)
    return int(mask.shape[1])
