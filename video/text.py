"""Anti-aliased text, and masks laid over pictures in a colour."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from video.palette import Colour

Picture = NDArray[np.uint8]
Mask = NDArray[np.uint8]

FONTS = Path(__file__).resolve().parent / "fonts"


@lru_cache(maxsize=32)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"), size)


@lru_cache(maxsize=1024)
def text_mask(text: str, size: int, bold: bool = False) -> Mask:
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


def number_mask(text: str, size: int, bold: bool = False) -> Mask:
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
def rounded_mask(width: int, height: int, radius: int) -> Mask:
    """Coverage (h, w) of a rectangle with round corners, drawn at four times its size; do not write into it."""
    image = Image.new("L", (width * 4, height * 4))
    ImageDraw.Draw(image).rounded_rectangle((0, 0, width * 4 - 1, height * 4 - 1), radius * 4, fill=255)
    mask = np.asarray(image.resize((width, height), Image.Resampling.BOX), dtype=np.uint8)
    mask.setflags(write=False)
    return mask


def lay(picture: Picture, mask: Mask, x: int, y: int, colour: Colour, opacity: float = 1.0) -> None:
    """Paint `colour` through `mask` (h, w) with its top-left pixel at (x, y), in place; what is outside is cut."""
    height, width = picture.shape[:2]
    left, top = max(0, -x), max(0, -y)
    part = mask[top : max(top, height - y), left : max(left, width - x)]
    if part.size == 0 or opacity <= 0:
        return
    ground = picture[y + top : y + top + part.shape[0], x + left : x + left + part.shape[1]]
    cover, solid = part * np.float32(opacity / 255), np.empty_like(ground)
    solid[:] = colour
    ground[:] = cv2.blendLinear(solid, ground, cover, 1 - cover)


def lay_sparse(picture: Picture, layers: Sequence[tuple[Mask, Colour]], x: int, y: int, free: Mask) -> None:
    """As `lay`, one layer upon the other where the picture is `free` (H, W; 0 to 255), touching covered pixels alone.

    For large masks that are mostly empty, lie inside the picture, and cover no more than the first of them. The picture
    is in one piece: ValueError otherwise.
    """
    if not picture.flags.c_contiguous:
        raise ValueError("lay_sparse draws on pictures that are in one piece; got a part of one")
    found = cv2.findNonZero(layers[0][0])
    if found is None:
        return
    columns, rows = found.reshape(-1, 2).T.astype(np.intp)
    here, there = rows * layers[0][0].shape[1] + columns, (rows + y) * picture.shape[1] + columns + x
    pixels = picture.reshape(-1, 3)  # numbered one by one, they are found in half the time
    ground, share = pixels[there].astype(np.float32), free.reshape(-1)[there] * np.float32(1 / (255 * 255))
    for mask, colour in layers:
        ground += (np.asarray(colour, dtype=np.float32) - ground) * (mask.reshape(-1)[here] * share)[:, None]
    pixels[there] = np.rint(ground).astype(np.uint8)


def write(
    picture: Picture, text: str, x: float, y: float, size: int, colour: Colour, bold: bool = False, opacity: float = 1.0
) -> int:
    """Write a line with its top-left corner at (x, y), in place; returns its width in px."""
    mask = text_mask(text, size, bold)
    lay(picture, mask, round(x), round(y), colour, opacity)
    return int(mask.shape[1])
