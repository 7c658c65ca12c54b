"""What crawls: lines of text and banners that go one way as a whole, farther between two pictures than flow can follow.

A letter looks like the next one, so a flow that grows from coarse to fine loses a line of text that moves by more than
a letter. All of it together tells its way by phase correlation (Kuglin and Hines 1975).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import Float32Array, ImageArray

MOST_WAYS = 2
"""Ways that are looked for in one box."""
LEAST_WAY_PX = 3.0
"""A flow follows shorter ones."""
LEAST_SHARE = 0.04
"""Height of a peak, 1 where both pictures are one that moved, from which it is tried: below are chance and coding."""
LOCAL_PX = 9
"""Side of the window whose mean is taken off the pictures, so that letters count and not what is behind them."""
LEAST_CHANGE = 12.0
"""Levels of 255 from which a place counts as changed."""
WINDOW = 5
"""px over which the two ends of a way are compared."""
BETTER, SURE = 6.0, 12.0
"""Levels by which a way must agree better than the flow's, and by which its ends may differ at the most."""
LEAST_AREA = 160
"""px that a way must explain better for it to be one."""


def crawling_ways(first: ImageArray, second: ImageArray) -> list[Float32Array]:
    """The ways (2,) px that something may crawl from one grey picture (h, w) to another; back, the opposite ones."""
    if min(first.shape) < LOCAL_PX:
        return []
    changed = cv2.blur(cv2.absdiff(first, second), (WINDOW, WINDOW)) > LEAST_CHANGE
    return _ways(first, second, changed) if np.count_nonzero(changed) >= LEAST_AREA else []


def with_crawls(
    flow: Float32Array, first: ImageArray, second: ImageArray, ways: list[Float32Array], grid: Float32Array
) -> Float32Array:
    """A flow (h, w, 2) px from one grey picture to another, with the ways of what crawls where these agree better.

    `grid` (h, w, 2) px is every pixel's own place.
    """
    if not ways:
        return flow
    cost = _differences(first, second, grid + flow)
    for way in ways:
        crawl = np.broadcast_to(way, flow.shape)
        theirs = _differences(first, second, grid + crawl)
        better = (cost - theirs > BETTER) & (theirs < SURE)
        if np.count_nonzero(better) >= LEAST_AREA:
            # Between the letters that say so the ground goes with them.
            better = (cv2.dilate(better.view(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)) > 0) & (theirs <= cost)
            flow = np.where(better[..., None], crawl, flow)
            cost = np.where(better, theirs, cost)
    return flow


def _differences(first: ImageArray, second: ImageArray, where: Float32Array) -> Float32Array:
    """(h, w) levels by which each pixel of the one picture and where (h, w, 2) px it leads differ, around it."""
    there = cv2.remap(second, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.blur(cv2.absdiff(first, np.asarray(there)).astype(np.float32), (WINDOW, WINDOW)))


def _ways(first: ImageArray, second: ImageArray, changed: NDArray[np.bool_]) -> list[Float32Array]:
    """The likeliest ways (x, y) px of what changed as a whole, to a fraction of a px."""
    height, width = (cv2.getOptimalDFTSize(side) for side in first.shape)
    weight = cv2.GaussianBlur(changed.astype(np.float32), (0, 0), 2.0)
    spectra = []
    for picture in (first, second):
        detail = picture.astype(np.float32)
        detail = (detail - cv2.blur(detail, (LOCAL_PX, LOCAL_PX))) * weight
        framed = np.zeros((height, width), dtype=np.float32)
        framed[: first.shape[0], : first.shape[1]] = detail
        spectra.append(np.fft.rfft2(framed))
    cross = np.conj(spectra[0]) * spectra[1]
    softness = _softness(height, width)
    peaks = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-6) * softness, s=(height, width))
    least, found = LEAST_SHARE * softness.mean(), list[Float32Array]()
    for _ in range(2 * MOST_WAYS):
        row, column = np.unravel_index(int(peaks.argmax()), peaks.shape)
        if len(found) == MOST_WAYS or peaks[row, column] < least:
            break
        way = _top(peaks, int(row), int(column))
        if np.hypot(*way) > LEAST_WAY_PX:
            found.append(np.array(way, dtype=np.float32))
        for dy in range(-2, 3):
            peaks[(row + dy) % height, (column + np.arange(-2, 3)) % width] = 0
    return found


@lru_cache(maxsize=32)
def _softness(height: int, width: int) -> NDArray[np.float64]:
    """Weights (h, w // 2 + 1) of the frequencies: the highest are noise."""
    y, x = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    return np.asarray(np.exp(-0.5 * (x**2 + y**2) / 0.2**2))


def _top(peaks: NDArray[np.float64], row: int, column: int) -> tuple[float, float]:
    """Place (x, y) of a peak between its neighbours, of a plane whose sides meet."""
    height, width = peaks.shape
    tops = []
    for at, size, line in ((column, width, peaks[row]), (row, height, peaks[:, column])):
        before, there, behind = line[(at - 1) % size], line[at], line[(at + 1) % size]
        bend = before - 2 * there + behind
        off = 0.5 * (before - behind) / bend if bend < 0 else 0.0
        tops.append(float((at + off + size / 2) % size - size / 2))
    return tops[0], tops[1]
