"""Compiled loops over pixels, where each step in NumPy would allocate an array of its own.

Images are (H, W, 3) uint8 in RGB order.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, ImageArray
from models.numerics.jit import compile_kernel

# px, side of the cells to which an image is reduced.
CELL_PX = 4


@compile_kernel
def _sum_2x2(upper: ByteArray, lower: ByteArray, k: int) -> np.float32:
    """Sum one colour over 2 x 2 pixels of two rows (3 W,)."""
    above = np.float32(upper[k]) + np.float32(upper[k + 3])
    return above + np.float32(lower[k]) + np.float32(lower[k + 3])


@compile_kernel
def fill_yuv_planes(
    rgb: ImageArray,
    bright: ByteArray,
    blue: ByteArray,
    red: ByteArray,
    shares: Float32Array,
    box: tuple[int, int, int, int],
) -> None:
    """Write the luma (H, W) of a box of an image, and its chroma planes (H / 2, W / 2), of 2 x 2 pixels together.

    `shares` (3, 4): weights of red, green and blue for each plane (for chroma those of the sum of four pixels), and an
    offset that includes the half for rounding. `box` is x0, y0, x1, y1 px, all even; the image must be C-contiguous.
    """
    x0, y0, x1, y1 = box
    wide = rgb.reshape(rgb.shape[0], 3 * rgb.shape[1])
    a0, a1, a2, a3 = shares[0]
    for j in range(y0, y1):
        line, output = wide[j, 3 * x0 : 3 * x1], bright[j, x0:x1]
        for i in range(x1 - x0):
            r, g, b = np.float32(line[3 * i]), np.float32(line[3 * i + 1]), np.float32(line[3 * i + 2])
            output[i] = np.uint8(np.int32(a0 * r + a1 * g + a2 * b + a3))
    b0, b1, b2, b3 = shares[1]
    c0, c1, c2, c3 = shares[2]
    left, right = x0 // 2, x1 // 2
    for j in range(y0 // 2, y1 // 2):
        upper, lower = wide[2 * j, 3 * x0 : 3 * x1], wide[2 * j + 1, 3 * x0 : 3 * x1]
        bluish, reddish = blue[j, left:right], red[j, left:right]
        for i in range(right - left):
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
def blend_rgb(image: ImageArray, colours: ImageArray, cover: ByteArray, x: int, y: int, opacity: float) -> None:
    """Blend colours into an image through a mask, in place; parts outside the image are cut off.

    Args:
        image: (H, W, 3).
        colours: (h, w, 3), or (1, 1, 3) for one colour everywhere.
        cover: (h, w) coverage, 0 to 255.
        x: column of the mask's left edge, px.
        y: row of the mask's top edge, px.
        opacity: 0 to 1, multiplies `cover`.
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


@compile_kernel
def blend_yuv(
    bright: ByteArray,
    blue: ByteArray,
    red: ByteArray,
    colours: ImageArray,
    cover: ByteArray,
    x: int,
    y: int,
    opacity: float,
) -> None:
    """Blend Y', Cb, Cr into the planes of a frame as `blend_rgb` does; the chroma of 2 x 2 pixels is their mean.

    `bright` is (H, W), `blue` and `red` are (H / 2, W / 2) rounded up; the other arguments are those of `blend_rgb`.
    """
    has_one, quarter, half = colours.shape[0] == 1, np.float32(0.25), np.float32(0.5)
    most, step = np.float32(opacity / 255), np.intp(not has_one)
    top, bottom = max(y, 0), min(y + cover.shape[0], bright.shape[0])
    left, right = max(x, 0), min(x + cover.shape[1], bright.shape[1])
    for v in range(top, bottom):  # without branches, so that several pixels are computed at once
        line, mask, paint = bright[v, left:right], cover[v - y, left - x : right - x], colours[step * (v - y)]
        if has_one:
            for n in range(len(line)):
                level = np.float32(line[n])
                level += (np.float32(paint[0, 0]) - level) * (most * np.float32(mask[n]))
                line[n] = np.uint8(np.int32(level + half))
        else:
            for n in range(len(line)):
                level = np.float32(line[n])
                level += (np.float32(paint[left - x + n, 0]) - level) * (most * np.float32(mask[n]))
                line[n] = np.uint8(np.int32(level + half))
    for j in range(top // 2, (bottom + 1) // 2):
        for i in range(left // 2, (right + 1) // 2):
            whole = bluer = redder = np.float32(0)
            for v in range(max(2 * j, top) - y, min(2 * j + 2, bottom) - y):
                for u in range(max(2 * i, left) - x, min(2 * i + 2, right) - x):
                    if cover[v, u]:
                        share = most * np.float32(cover[v, u])
                        whole += share
                        bluer += share * np.float32(colours[step * v, step * u, 1])
                        redder += share * np.float32(colours[step * v, step * u, 2])
            if whole > np.float32(0):
                rest = np.float32(1) - quarter * whole
                blue[j, i] = np.uint8(np.int32(rest * np.float32(blue[j, i]) + quarter * bluer + half))
                red[j, i] = np.uint8(np.int32(rest * np.float32(red[j, i]) + quarter * redder + half))


@compile_kernel
def blend_displaced(
    image: ImageArray,
    x0: int,
    y0: int,
    first: ImageArray,
    second: ImageArray,
    weight: Float32Array,
    displacements: Float32Array,
    doubts: Float32Array,
    trusts: Float32Array,
    share: float,
    nearer: float,
) -> None:
    """Blend two images, each sampled along displacements between them, onto a box of another one, in place.

    Args:
        image: (H, W, 3).
        x0: Left column of the box.
        y0: Top row of the box.
        first: (h, w, 3) image at share 0.
        second: (h, w, 3) image at share 1.
        weight: (h, w) weight of the result, 0 to 1; nothing is computed where it is 0.
        displacements: (n, k, l, 2) px of the box, from the first image to the second; n candidates, at reduced size.
        doubts: (n, k, l) 0 to 1; 1 where the ends of a displacement show different objects.
        trusts: (n, k, l) weights of the candidates, which add to 1.
        share: Elapsed share of the time, the weight of the second image.
        nearer: The same where the ends differ: the nearer image has nearly all of it.
    """
    one, zero, half = np.float32(1), np.float32(0), np.float32(0.5)
    height, width = weight.shape
    rows, columns = doubts.shape[1:]
    down, across = np.float32(rows / height), np.float32(columns / width)
    after, before = np.float32(share), np.float32(1 - share)
    for j in range(height):
        v = min(max((np.float32(j) + half) * down - half, zero), np.float32(rows - 1))
        v0 = np.intp(v)
        v1, v = min(v0 + 1, rows - 1), v - np.float32(v0)
        for i in range(width):
            if weight[j, i] <= zero:
                continue
            u = min(max((np.float32(i) + half) * across - half, zero), np.float32(columns - 1))
            u0 = np.intp(u)
            u1, u = min(u0 + 1, columns - 1), u - np.float32(u0)
            a, b, c, d = (one - u) * (one - v), u * (one - v), (one - u) * v, u * v
            red = green = blue = zero
            for n in range(len(doubts)):
                field, doubt, trust = displacements[n], doubts[n], trusts[n]
                sure = a * trust[v0, u0] + b * trust[v0, u1] + c * trust[v1, u0] + d * trust[v1, u1]
                unlike = a * doubt[v0, u0] + b * doubt[v0, u1] + c * doubt[v1, u0] + d * doubt[v1, u1]
                x = a * field[v0, u0, 0] + b * field[v0, u1, 0] + c * field[v1, u0, 0] + d * field[v1, u1, 0]
                y = a * field[v0, u0, 1] + b * field[v0, u1, 1] + c * field[v1, u0, 1] + d * field[v1, u1, 1]
                later = after + (np.float32(nearer) - after) * unlike
                r, g, s = _sample_pixel(first, np.float32(i) - after * x, np.float32(j) - after * y)
                red, green, blue = (
                    red + sure * (one - later) * r,
                    green + sure * (one - later) * g,
                    blue + sure * (one - later) * s,
                )
                r, g, s = _sample_pixel(second, np.float32(i) + before * x, np.float32(j) + before * y)
                red, green, blue = red + sure * later * r, green + sure * later * g, blue + sure * later * s
            whole, pixel = weight[j, i], image[y0 + j, x0 + i]
            pixel[0] = np.uint8(np.int32(np.float32(pixel[0]) * (one - whole) + red * whole + half))
            pixel[1] = np.uint8(np.int32(np.float32(pixel[1]) * (one - whole) + green * whole + half))
            pixel[2] = np.uint8(np.int32(np.float32(pixel[2]) * (one - whole) + blue * whole + half))


@compile_kernel
def _sample_pixel(image: ImageArray, x: np.float32, y: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    """Sample an image (H, W, 3) at a place by bilinear interpolation; beyond the border its last pixel."""
    x = min(max(x, np.float32(0)), np.float32(image.shape[1] - 1))
    y = min(max(y, np.float32(0)), np.float32(image.shape[0] - 1))
    left, top = np.intp(x), np.intp(y)
    right, bottom = min(left + 1, image.shape[1] - 1), min(top + 1, image.shape[0] - 1)
    u, v, one = x - np.float32(left), y - np.float32(top), np.float32(1)
    a, b, c, d = (one - u) * (one - v), u * (one - v), (one - u) * v, u * v
    return (
        a * image[top, left, 0] + b * image[top, right, 0] + c * image[bottom, left, 0] + d * image[bottom, right, 0],
        a * image[top, left, 1] + b * image[top, right, 1] + c * image[bottom, left, 1] + d * image[bottom, right, 1],
        a * image[top, left, 2] + b * image[top, right, 2] + c * image[bottom, left, 2] + d * image[bottom, right, 2],
    )


@compile_kernel
def copy_yuv(bright: ByteArray, blue: ByteArray, red: ByteArray, x: int, y: int, patch: ImageArray) -> None:
    """Copy the levels of a box of a frame, each pixel with its chroma, into `patch` (h, w, 3).

    The planes are those of `blend_yuv`; the box, whose top-left pixel is (x, y), lies inside.
    """
    for j in range(patch.shape[0]):
        for i in range(patch.shape[1]):
            patch[j, i, 0] = bright[y + j, x + i]
            patch[j, i, 1], patch[j, i, 2] = blue[(y + j) // 2, (x + i) // 2], red[(y + j) // 2, (x + i) // 2]


# x0, y0, x1, y1 in px
Box = tuple[int, int, int, int]

# Luma weights of RGB (BT.601); other standards differ by a few hundredths.
LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
# Largest deviation from the chroma of the own 2 x 2 block, relative to that on a shifted grid; rounding alone gives a
# tenth.
MAX_ALIGNED_SHARE = 0.3
# One of this many rows of blocks is examined.
SAMPLED_ROW_STEP = 8


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
