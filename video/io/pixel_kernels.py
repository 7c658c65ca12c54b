"""Loops over the pixels of pictures, compiled: where each step of a small sum would be an array of its own.

Pictures are (H, W, 3) uint8, red, green, blue.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, ImageArray
from models.numerics.jit import compiled

CELL = 4
"""px per side of the cells that a picture is made coarse by."""


@compiled
def _four(upper: ByteArray, lower: ByteArray, k: int) -> np.float32:
    """Sum of one colour over 2 x 2 pixels of two lines (3 W,)."""
    above = np.float32(upper[k]) + np.float32(upper[k + 3])
    return above + np.float32(lower[k]) + np.float32(lower[k + 3])


@compiled
def fill_planes(rgb: ImageArray, bright: ByteArray, blue: ByteArray, red: ByteArray, shares: Float32Array) -> None:
    """Write the brightness (H, W) of a picture, and its two colours (H / 2, W / 2), of 2 x 2 pixels together.

    `shares` (3, 4): what red, green and blue add to each, to the colours those of four pixels, and what is added
    besides: the half that rounds is part of it.
    """
    height, width = bright.shape
    wide = rgb.reshape(height, 3 * width)
    a0, a1, a2, a3 = shares[0]
    for j in range(height):
        line, made = wide[j], bright[j]
        for i in range(width):
            r, g, b = np.float32(line[3 * i]), np.float32(line[3 * i + 1]), np.float32(line[3 * i + 2])
            made[i] = np.uint8(np.int32(a0 * r + a1 * g + a2 * b + a3))
    b0, b1, b2, b3 = shares[1]
    c0, c1, c2, c3 = shares[2]
    for j in range(height // 2):
        upper, lower, bluish, reddish = wide[2 * j], wide[2 * j + 1], blue[j], red[j]
        for i in range(width // 2):
            r, g, b = _four(upper, lower, 6 * i), _four(upper, lower, 6 * i + 1), _four(upper, lower, 6 * i + 2)
            bluish[i] = np.uint8(np.int32(b0 * r + b1 * g + b2 * b + b3))
            reddish[i] = np.uint8(np.int32(c0 * r + c1 * g + c2 * b + c3))


@compiled
def fill_mixed(first: ByteArray, second: ByteArray, share: float, mixed: ByteArray) -> None:
    """Write the mean (n,) of levels, of which the second (n,) counts a share of 0 to 1."""
    one, other, half = np.float32(1 - share), np.float32(share), np.float32(0.5)
    for n in range(len(mixed)):
        mixed[n] = np.uint8(np.int32(np.float32(first[n]) * one + np.float32(second[n]) * other + half))


@compiled
def fill_cells(picture: ImageArray, cells: ImageArray) -> None:
    """Write the mean (h, w, 3) of every `CELL` x `CELL` pixels of a picture in one piece, halves to even."""
    height, width = cells.shape[:2]
    wide = picture.reshape(CELL * height, 3 * CELL * width)
    made = cells.reshape(height, 3 * width)
    total = np.empty(3 * CELL * width, dtype=np.uint16)
    for j in range(height):
        a, b, c, d = wide[CELL * j], wide[CELL * j + 1], wide[CELL * j + 2], wide[CELL * j + 3]
        for n in range(len(total)):
            total[n] = np.uint16(a[n]) + np.uint16(b[n]) + np.uint16(c[n]) + np.uint16(d[n])
        line = made[j]
        for i in range(width):
            for k in range(3):
                n = 3 * CELL * i + k
                level = (
                    np.uint32(total[n]) + np.uint32(total[n + 3]) + np.uint32(total[n + 6]) + np.uint32(total[n + 9])
                )
                even = (level >> np.uint32(4)) & np.uint32(1)
                line[3 * i + k] = np.uint8((level + np.uint32(7) + even) >> np.uint32(4))


@compiled
def dots(first: Float32Array, second: Float32Array) -> Float32Array:
    """Scalar products (n,) of colours (n, 3) with others (n, 3), or all with one (1, 3)."""
    products = np.empty(len(first), dtype=np.float32)
    step = np.intp(len(second) > 1)
    for n in range(len(first)):
        a, b = first[n], second[n * step]
        products[n] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return products


@compiled
def unlike(seen: ImageArray, empty: Float32Array, light: Float32Array, other: Float32Array) -> None:
    """Write how bright (h, w) pixels are against an empty place (h, w, 3), and by how much they are then unlike it."""
    for j in range(seen.shape[0]):
        for i in range(seen.shape[1]):
            both = own = np.float32(0)
            for k in range(3):
                both += np.float32(seen[j, i, k]) * empty[j, i, k]
                own += empty[j, i, k] * empty[j, i, k]
            share = both / max(own, np.float32(1))
            most = np.float32(0)
            for k in range(3):
                most = max(most, abs(np.float32(seen[j, i, k]) - share * empty[j, i, k]))
            light[j, i], other[j, i] = share, most


@compiled
def square(picture: ImageArray, x0: int, y0: int, x1: int, y1: int, luma: Float32Array) -> None:
    """Give every 2 x 2 pixels of a box, whose borders are even, one colour, in place; `luma` (3,) is kept of each.

    The picture is in one piece.
    """
    quarter, half = np.float32(0.25), np.float32(0.5)
    wide = picture.reshape(picture.shape[0], 3 * picture.shape[1])
    for y in range(y0, y1, 2):
        upper, lower = wide[y], wide[y + 1]
        for k in range(3 * x0, 3 * x1, 6):
            r, g, b = _four(upper, lower, k), _four(upper, lower, k + 1), _four(upper, lower, k + 2)
            grey = luma[0] * r + luma[1] * g + luma[2] * b
            r, g, b = quarter * (r - grey) + half, quarter * (g - grey) + half, quarter * (b - grey) + half
            for line in (upper, lower):
                for n in (k, k + 3):
                    own = np.float32(line[n]) * luma[0] + np.float32(line[n + 1]) * luma[1]
                    own += np.float32(line[n + 2]) * luma[2]
                    line[n], line[n + 1], line[n + 2] = _level(own + r), _level(own + g), _level(own + b)


@compiled
def _level(value: np.float32) -> np.uint8:
    """What is left of a value without its fraction, 0 to 255."""
    return np.uint8(np.int32(min(max(value, np.float32(0)), np.float32(255))))


@compiled
def paint(picture: ImageArray, mask: ByteArray, x: int, y: int, colour: tuple[int, int, int], opacity: float) -> None:
    """Lay a colour over a picture through a mask (h, w), its top-left pixel at (x, y); what is outside is cut."""
    rows, columns = picture.shape[:2]
    for j in range(max(0, -y), min(mask.shape[0], rows - y)):
        for i in range(max(0, -x), min(mask.shape[1], columns - x)):
            if mask[j, i]:
                share = opacity * mask[j, i] / 255
                for k in range(3):
                    level = picture[y + j, x + i, k]
                    picture[y + j, x + i, k] = np.uint8(level + (colour[k] - level) * share + 0.5)


@compiled
def lay_over(picture: ImageArray, colours: ImageArray, cover: Float32Array, x: int, y: int, opacity: float) -> None:
    """Lay colours (h, w, 3) over a picture as far as they cover it, (h, w) 0 to 1, their top-left pixel at (x, y).

    What is outside is cut.
    """
    rows, columns = picture.shape[:2]
    half, most = np.float32(0.5), np.float32(opacity)
    for j in range(max(0, -y), min(cover.shape[0], rows - y)):
        for i in range(max(0, -x), min(cover.shape[1], columns - x)):
            share = most * cover[j, i]
            for k in range(3):
                level = np.float32(picture[y + j, x + i, k])
                level += (np.float32(colours[j, i, k]) - level) * share
                picture[y + j, x + i, k] = np.uint8(np.int32(level + half))


@compiled
def paint_where(
    picture: ImageArray,
    places: NDArray[np.int32],
    masks: tuple[ByteArray, ...],
    x: int,
    y: int,
    colours: tuple[tuple[int, int, int], ...],
    free: ByteArray,
) -> None:
    """Lay colours through masks, one upon the other, over a picture where it is `free` (H, W), 0 to 255.

    `places` (n, 2) are the columns and rows of the masks that are looked at: all inside the picture.
    """
    for n in range(len(places)):
        i, j = places[n, 0], places[n, 1]
        share = free[y + j, x + i] / (255.0 * 255.0)
        for k in range(3):
            level = float(picture[y + j, x + i, k])
            for layer in range(len(masks)):
                level += (colours[layer][k] - level) * (masks[layer][j, i] * share)
            picture[y + j, x + i, k] = np.uint8(level + 0.5)
