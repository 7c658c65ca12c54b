"""Compiled loops over pixels, where each step in NumPy would allocate an array of its own.

Images are (H, W, 3) uint8 in RGB order.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, ImageArray
from models.numerics.jit import compile_kernel

CELL_PX = 4
"""px, side of the cells to which an image is reduced."""


@compile_kernel
def _sum_2x2(upper: ByteArray, lower: ByteArray, k: int) -> np.float32:
    """Sum one colour over 2 x 2 pixels of two rows (3 W,)."""
    above = np.float32(upper[k]) + np.float32(upper[k + 3])
    return above + np.float32(lower[k]) + np.float32(lower[k + 3])


@compile_kernel
def fill_yuv_planes(rgb: ImageArray, bright: ByteArray, blue: ByteArray, red: ByteArray, shares: Float32Array) -> None:
    """Write the luma (H, W) of an image, and its two chroma planes (H / 2, W / 2), each of 2 x 2 pixels together.

    `shares` (3, 4): weights of red, green and blue for each plane (for chroma those of the sum of four pixels), and an
    offset that includes the half for rounding.
    """
    height, width = bright.shape
    wide = rgb.reshape(height, 3 * width)
    a0, a1, a2, a3 = shares[0]
    for j in range(height):
        line, output = wide[j], bright[j]
        for i in range(width):
            r, g, b = np.float32(line[3 * i]), np.float32(line[3 * i + 1]), np.float32(line[3 * i + 2])
            output[i] = np.uint8(np.int32(a0 * r + a1 * g + a2 * b + a3))
    b0, b1, b2, b3 = shares[1]
    c0, c1, c2, c3 = shares[2]
    for j in range(height // 2):
        upper, lower, bluish, reddish = wide[2 * j], wide[2 * j + 1], blue[j], red[j]
        for i in range(width // 2):
            r, g, b = (
                _sum_2x2(upper, lower, 6 * i),
                _sum_2x2(upper, lower, 6 * i + 1),
                _sum_2x2(upper, lower, 6 * i + 2),
            )
            bluish[i] = np.uint8(np.int32(b0 * r + b1 * g + b2 * b + b3))
            reddish[i] = np.uint8(np.int32(c0 * r + c1 * g + c2 * b + c3))


@compile_kernel
def fill_blend(first: ByteArray, second: ByteArray, share: float, mixed: ByteArray) -> None:
    """Write the weighted mean (n,) of two arrays of levels.

    Args:
        first: (n,) levels.
        second: (n,) levels.
        share: weight of `second`, 0 to 1.
        mixed: (n,) output.
    """
    one, other, half = np.float32(1 - share), np.float32(share), np.float32(0.5)
    for n in range(len(mixed)):
        mixed[n] = np.uint8(np.int32(np.float32(first[n]) * one + np.float32(second[n]) * other + half))


@compile_kernel
def fill_cell_means(image: ImageArray, cells: ImageArray) -> None:
    """Write the mean of every `CELL_PX` x `CELL_PX` pixels; halves round to even.

    Args:
        image: (CELL_PX h, CELL_PX w, 3), C-contiguous.
        cells: (h, w, 3) output.
    """
    height, width = cells.shape[:2]
    wide = image.reshape(CELL_PX * height, 3 * CELL_PX * width)
    rows = cells.reshape(height, 3 * width)
    total = np.empty(3 * CELL_PX * width, dtype=np.uint16)
    for j in range(height):
        a, b, c, d = wide[CELL_PX * j], wide[CELL_PX * j + 1], wide[CELL_PX * j + 2], wide[CELL_PX * j + 3]
        for n in range(len(total)):
            total[n] = np.uint16(a[n]) + np.uint16(b[n]) + np.uint16(c[n]) + np.uint16(d[n])
        row = rows[j]
        for i in range(width):
            for k in range(3):
                n = 3 * CELL_PX * i + k
                level = (
                    np.uint32(total[n]) + np.uint32(total[n + 3]) + np.uint32(total[n + 6]) + np.uint32(total[n + 9])
                )
                even = (level >> np.uint32(4)) & np.uint32(1)
                row[3 * i + k] = np.uint8((level + np.uint32(7) + even) >> np.uint32(4))


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
                luminance = np.float32(0.2126) * light[j, i, 0] + np.float32(0.7152) * light[j, i, 1]
                gain = (luminance + np.float32(0.0722) * light[j, i, 2]) ** exponent
                for k in range(3):
                    light[j, i, k] *= gain


@compile_kernel
def dot_products(first: Float32Array, second: Float32Array) -> Float32Array:
    """Compute the scalar products of colours.

    Args:
        first: (n, 3) colours.
        second: (n, 3), or (1, 3) for one colour against all.

    Returns:
        (n,) scalar products.
    """
    products = np.empty(len(first), dtype=np.float32)
    step = np.intp(len(second) > 1)
    for n in range(len(first)):
        a, b = first[n], second[n * step]
        products[n] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return products


@compile_kernel
def fill_background_difference(
    image: ImageArray, background: Float32Array, brightness: Float32Array, difference: Float32Array
) -> None:
    """Compare pixels with the background: brightness ratio, and the residual after scaling the background by it.

    Args:
        image: (h, w, 3).
        background: (h, w, 3).
        brightness: (h, w) output: factor by which the background is scaled to match best.
        difference: (h, w) output: largest absolute difference of the three colours to the scaled background.
    """
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            both = own = np.float32(0)
            for k in range(3):
                both += np.float32(image[j, i, k]) * background[j, i, k]
                own += background[j, i, k] * background[j, i, k]
            share = both / max(own, np.float32(1))
            most = np.float32(0)
            for k in range(3):
                most = max(most, abs(np.float32(image[j, i, k]) - share * background[j, i, k]))
            brightness[j, i], difference[j, i] = share, most


@compile_kernel
def average_chroma(image: ImageArray, x0: int, y0: int, x1: int, y1: int, luma: Float32Array) -> None:
    """Give every 2 x 2 pixels of a box with even borders one chroma value, in place; the luma of each pixel stays.

    `luma` (3,) are the luma weights. The image must be C-contiguous.
    """
    quarter, half = np.float32(0.25), np.float32(0.5)
    wide = image.reshape(image.shape[0], 3 * image.shape[1])
    for y in range(y0, y1, 2):
        upper, lower = wide[y], wide[y + 1]
        for k in range(3 * x0, 3 * x1, 6):
            r, g, b = _sum_2x2(upper, lower, k), _sum_2x2(upper, lower, k + 1), _sum_2x2(upper, lower, k + 2)
            grey = luma[0] * r + luma[1] * g + luma[2] * b
            r, g, b = quarter * (r - grey) + half, quarter * (g - grey) + half, quarter * (b - grey) + half
            for line in (upper, lower):
                for n in (k, k + 3):
                    own = np.float32(line[n]) * luma[0] + np.float32(line[n + 1]) * luma[1]
                    own += np.float32(line[n + 2]) * luma[2]
                    line[n], line[n + 1], line[n + 2] = (
                        _round_down_to_byte(own + r),
                        _round_down_to_byte(own + g),
                        _round_down_to_byte(own + b),
                    )


@compile_kernel
def _round_down_to_byte(value: np.float32) -> np.uint8:
    """Truncate a value and limit it to 0 to 255."""
    return np.uint8(np.int32(min(max(value, np.float32(0)), np.float32(255))))


@compile_kernel
def paint_mask(
    image: ImageArray, mask: ByteArray, x: int, y: int, colour: tuple[int, int, int], opacity: float
) -> None:
    """Blend a colour into an image through a mask, in place; parts outside the image are cut off.

    Args:
        image: (H, W, 3).
        mask: (h, w) coverage, 0 to 255.
        x: column of the mask's left edge, px.
        y: row of the mask's top edge, px.
        colour: red, green and blue, 0 to 255.
        opacity: 0 to 1.
    """
    rows, columns = image.shape[:2]
    for j in range(max(0, -y), min(mask.shape[0], rows - y)):
        for i in range(max(0, -x), min(mask.shape[1], columns - x)):
            if mask[j, i]:
                share = opacity * mask[j, i] / 255
                for k in range(3):
                    level = image[y + j, x + i, k]
                    image[y + j, x + i, k] = np.uint8(level + (colour[k] - level) * share + 0.5)


@compile_kernel
def blend_colours(image: ImageArray, colours: ImageArray, alpha: Float32Array, x: int, y: int, opacity: float) -> None:
    """Blend an image with transparency into another, in place; parts outside are cut off.

    Args:
        image: (H, W, 3).
        colours: (h, w, 3) colours of the upper image.
        alpha: (h, w) coverage, 0 to 1.
        x: column of its left edge, px.
        y: row of its top edge, px.
        opacity: 0 to 1, multiplies `alpha`.
    """
    rows, columns = image.shape[:2]
    half, most = np.float32(0.5), np.float32(opacity)
    for j in range(max(0, -y), min(alpha.shape[0], rows - y)):
        for i in range(max(0, -x), min(alpha.shape[1], columns - x)):
            share = most * alpha[j, i]
            for k in range(3):
                level = np.float32(image[y + j, x + i, k])
                level += (np.float32(colours[j, i, k]) - level) * share
                image[y + j, x + i, k] = np.uint8(np.int32(level + half))


@compile_kernel
def paint_masks(
    image: ImageArray,
    positions: NDArray[np.int32],
    masks: tuple[ByteArray, ...],
    x: int,
    y: int,
    colours: tuple[tuple[int, int, int], ...],
) -> None:
    """Blend several colours through masks, one over the other, in place.

    Args:
        image: (H, W, 3).
        positions: (n, 2) columns and rows of the mask pixels to paint; all must be inside the image.
        masks: each (h, w), 0 to 255.
        x: column of the masks' left edge, px.
        y: row of the masks' top edge, px.
        colours: one for each mask.
    """
    for n in range(len(positions)):
        i, j = positions[n, 0], positions[n, 1]
        for k in range(3):
            level = float(image[y + j, x + i, k])
            for layer in range(len(masks)):
                level += (colours[layer][k] - level) * (masks[layer][j, i] / 255.0)
            image[y + j, x + i, k] = np.uint8(level + 0.5)


Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in px"""

LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Luma weights of RGB (BT.601); other standards differ by a few hundredths."""
MAX_ALIGNED_SHARE = 0.3
"""Largest deviation from the chroma of the own 2 x 2 block, relative to that on a shifted grid; rounding alone gives a
tenth."""
SAMPLED_ROW_STEP = 8
"""One of this many rows of blocks is examined."""


def has_subsampled_chroma(image: ImageArray) -> bool:
    """Check whether an image has one chroma value for every 2 x 2 pixels.

    Args:
        image: (H, W, 3) uint8 RGB.

    Returns:
        True for frames decoded from 4:2:0 video.
    """
    own, shifted = (_mean_chroma_deviation(part) for part in (image, image[1:, 1:]))
    return own < MAX_ALIGNED_SHARE * shifted


def _mean_chroma_deviation(image: ImageArray) -> float:
    """Mean difference (levels of 255) between the pixels of (H, W, 3) and the chroma of their 2 x 2 block."""
    height, width = (side // 2 * 2 for side in image.shape[:2])
    rows = image[:height, :width].reshape(height // 2, 2, width, 3)[::SAMPLED_ROW_STEP]
    sample = np.ascontiguousarray(rows).reshape(-1, width, 3)
    return float(cv2.absdiff(_average_block_chroma(sample), sample.astype(np.float32)).mean())


def _average_block_chroma(image: ImageArray) -> Float32Array:
    """Replace the chroma of (h, w, 3) by that of its 2 x 2 blocks, without rounding: half a level may matter."""
    height, width = image.shape[:2]
    bright = cv2.transform(image.astype(np.float32), LUMA_WEIGHTS[None])[..., None]
    colour = cv2.resize(image - bright, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(bright + cv2.resize(colour, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def subsample_chroma(image: ImageArray, box: Box) -> None:
    """Give every 2 x 2 pixels inside a box one chroma value, in place; the luma of each pixel is unchanged.

    Args:
        image: (H, W, 3) uint8 RGB, C-contiguous.
        box: x0, y0, x1, y1 in px; extended outwards to even borders, and cut at the image.
    """
    x0, y0 = (max(side, 0) // 2 * 2 for side in box[:2])
    x1, y1 = (min(-(-side // 2) * 2, whole // 2 * 2) for side, whole in zip(box[2:], image.shape[1::-1], strict=True))
    if x1 > x0 and y1 > y0:
        average_chroma(image, x0, y0, x1, y1, LUMA_WEIGHTS)
