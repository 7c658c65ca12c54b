"""Detection of tickers: lines of text and banners that shift as a whole, farther than optical flow can follow.

Letters resemble each other, so a coarse-to-fine flow loses a line of text that shifts by more than one letter. The
shift of the whole line follows from phase correlation (Kuglin and Hines 1975).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import Float32Array, ImageArray

MAX_SHIFTS = 2
"""Shifts that are sought in one box."""
MIN_SHIFT_PX = 3.0
"""Optical flow follows shorter shifts."""
MIN_PEAK = 0.04
"""Least height of a correlation peak, 1 for a pure translation; lower peaks are chance and coding noise."""
HIGH_PASS_PX = 9
"""px, side of the window whose mean is subtracted, so that letters count and not the background."""
MIN_CHANGE = 12.0
"""Levels of 255 above which a pixel counts as changed."""
WINDOW_PX = 5
"""px over which the two ends of a shift are compared."""
MIN_IMPROVEMENT, MAX_DIFFERENCE = 6.0, 12.0
"""Levels by which a shift must fit better than the flow, and by which its two ends may differ at most."""
MIN_AREA_PX = 160
"""Pixels that a shift must explain better to be accepted."""


def find_ticker_shifts(first: ImageArray, second: ImageArray) -> list[Float32Array]:
    """Find the shifts of whole lines of text from one grey image (h, w) to another.

    Returns:
        Shifts (2,) px; the opposite shifts hold for the reverse direction.
    """
    if min(first.shape) < HIGH_PASS_PX:
        return []
    changed = cv2.blur(cv2.absdiff(first, second), (WINDOW_PX, WINDOW_PX)) > MIN_CHANGE
    return _find_shifts(first, second, changed) if np.count_nonzero(changed) >= MIN_AREA_PX else []


def apply_ticker_shifts(
    flow: Float32Array, first: ImageArray, second: ImageArray, shifts: list[Float32Array], grid: Float32Array
) -> Float32Array:
    """Replace a flow (h, w, 2) px by ticker shifts at the pixels where these fit both grey images better.

    `grid` (h, w, 2) px are the coordinates of every pixel.
    """
    if not shifts:
        return flow
    cost = _endpoint_difference(first, second, grid + flow)
    for shift in shifts:
        shift_field = np.broadcast_to(shift, flow.shape)
        shift_cost = _endpoint_difference(first, second, grid + shift_field)
        better = (cost - shift_cost > MIN_IMPROVEMENT) & (shift_cost < MAX_DIFFERENCE)
        if np.count_nonzero(better) >= MIN_AREA_PX:
            # The background between the letters shifts with them.
            better = (cv2.dilate(better.view(np.uint8), np.ones((WINDOW_PX, WINDOW_PX), np.uint8)) > 0) & (
                shift_cost <= cost
            )
            flow = np.where(better[..., None], shift_field, flow)
            cost = np.where(better, shift_cost, cost)
    return flow


def _endpoint_difference(first: ImageArray, second: ImageArray, where: Float32Array) -> Float32Array:
    """Return the levels (h, w) by which each pixel of the first image differs from its target `where` (h, w, 2) px."""
    sampled = cv2.remap(second, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.blur(cv2.absdiff(first, np.asarray(sampled)).astype(np.float32), (WINDOW_PX, WINDOW_PX)))


def _find_shifts(first: ImageArray, second: ImageArray, changed: NDArray[np.bool_]) -> list[Float32Array]:
    """Return the most likely shifts (x, y) px of the changed pixels as a whole, with subpixel accuracy."""
    height, width = (cv2.getOptimalDFTSize(side) for side in first.shape)
    weight = cv2.GaussianBlur(changed.astype(np.float32), (0, 0), 2.0)
    spectra = []
    for image in (first, second):
        detail = image.astype(np.float32)
        detail = (detail - cv2.blur(detail, (HIGH_PASS_PX, HIGH_PASS_PX))) * weight
        framed = np.zeros((height, width), dtype=np.float32)
        framed[: first.shape[0], : first.shape[1]] = detail
        spectra.append(np.fft.rfft2(framed))
    cross = np.conj(spectra[0]) * spectra[1]
    softness = _frequency_weights(height, width)
    peaks = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-6) * softness, s=(height, width))
    least, shifts = MIN_PEAK * softness.mean(), list[Float32Array]()
    for _ in range(2 * MAX_SHIFTS):
        row, column = np.unravel_index(int(peaks.argmax()), peaks.shape)
        if len(shifts) == MAX_SHIFTS or peaks[row, column] < least:
            break
        shift = _refine_peak(peaks, int(row), int(column))
        if np.hypot(*shift) > MIN_SHIFT_PX:
            shifts.append(np.array(shift, dtype=np.float32))
        for dy in range(-2, 3):
            peaks[(row + dy) % height, (column + np.arange(-2, 3)) % width] = 0
    return shifts


@lru_cache(maxsize=32)
def _frequency_weights(height: int, width: int) -> NDArray[np.float64]:
    """Return weights (h, w // 2 + 1) of the spatial frequencies; the highest are noise."""
    y, x = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    return np.asarray(np.exp(-0.5 * (x**2 + y**2) / 0.2**2))


def _refine_peak(peaks: NDArray[np.float64], row: int, column: int) -> tuple[float, float]:
    """Return the subpixel position (x, y) of a peak on a periodic plane, from its neighbours."""
    height, width = peaks.shape
    position = []
    for at, size, line in ((column, width, peaks[row]), (row, height, peaks[:, column])):
        left, centre, right = line[(at - 1) % size], line[at], line[(at + 1) % size]
        curvature = left - 2 * centre + right
        off = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
        position.append(float((at + off + size / 2) % size - size / 2))
    return position[0], position[1]
