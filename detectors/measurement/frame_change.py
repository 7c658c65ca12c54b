"""Change detection between the frames of a clip: balls are searched for only where the working image has changed.

A ball beside which nothing changed is measured again all the same, from where it was, so that the errors of different
frames are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.cloth_background import build_disc_kernel
from detectors.measurement.working_view import WorkingView
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

# Share of the cloth's threshold by which a place, averaged over 3 x 3 working px, must differ to count as changed.
CHANGED_SHARE = 0.4
# Distance, ball radii, up to which a change may concern a ball's centre.
REACH_RADII = 1.3
# Margin, ball radii, that the search for such centres needs around them.
MARGIN_RADII = 2.0
# Side of the blocks in which changes are stored, working px.
BLOCK_PX = 4
# Share of the working image from which on all of it is searched.
WHOLE_SHARE = 0.6
# Frames after which everything is searched again: a ball hidden in one frame may be visible in another.
FULL_SEARCH_INTERVAL = 15


@dataclass(frozen=True, slots=True)
class ForegroundScan:
    """Differences of a working image (h, w) from the empty table."""

    contrast: Float32Array
    """(h, w, 3)"""
    strength: Float32Array
    """(h, w) length of `contrast`."""
    foreground: BoolArray
    """(h, w) neither cloth nor a marking."""
    moving: BoolArray
    """(h, w) neither cloth nor part of the median image."""


@dataclass(frozen=True, slots=True)
class SearchMemory:
    """State of a search through a clip; its arrays are overwritten from frame to frame."""

    scan: ForegroundScan
    searched_image: ByteArray
    """(h, w, 3) working image as it was when each place was searched last."""
    working_centre: FloatArray
    """(n, 2) working px of the sharp balls of the last frame."""
    relative_radius: FloatArray
    """(n,) their measured over the predicted radius."""
    age: int
    """Frames since all of it was searched."""


def find_changed_pixels(working: ByteArray, searched: ByteArray, view: WorkingView, threshold: float) -> BoolArray:
    """Find the pixels that balls can cover and that changed since they were searched.

    Args:
        working: Working image (h, w, 3).
        searched: Working image (h, w, 3) at the last search.
        view: View of the table.
        threshold: Grey levels by which a pixel that is not cloth differs from it.

    Returns:
        Mask (h, w).
    """
    red, green, blue = cv2.split(cv2.absdiff(working, searched))
    change = cv2.blur(cv2.max(cv2.max(red, green), blue), (3, 3))
    return np.asarray((change > CHANGED_SHARE * threshold) & view.ball_area)


def find_touched_places(
    memory: SearchMemory | None, working: ByteArray, view: WorkingView, threshold: float
) -> BoolArray:
    """Find where balls have to be searched for in a working image.

    Args:
        memory: State after the previous frame, None for the first.
        working: Working image (h, w, 3).
        view: View of the table.
        threshold: Grey levels by which a pixel that is not cloth differs from it.

    Returns:
        Mask (h, w).
    """
    if memory is None or memory.age >= FULL_SEARCH_INTERVAL:
        return np.ones(view.radius.shape, dtype=bool)
    blocks = _places_to_blocks(find_changed_pixels(working, memory.searched_image, view, threshold))
    return _blocks_to_places(dilate_places(blocks, REACH_RADII * view.median_radius / BLOCK_PX), view)


def dilate_places(places: BoolArray, reach: float) -> BoolArray:
    """Dilate a mask by a disc.

    Args:
        places: Mask (h, w).
        reach: Radius of the disc, px.

    Returns:
        Mask (h, w).
    """
    return np.asarray(cv2.dilate(places.astype(np.uint8), build_disc_kernel(reach)) > 0)


def find_windows(touched: BoolArray, view: WorkingView) -> list[tuple[slice, slice]]:
    """Find windows that hold the touched places and their surroundings.

    Args:
        touched: Mask (h, w).
        view: View of the table.

    Returns:
        Rows and columns of each window.
    """
    h, w = touched.shape
    if touched.all():
        return [(slice(0, h), slice(0, w))]
    margin = int(np.ceil(MARGIN_RADII * float(view.radius.max()) / BLOCK_PX))
    grown = cv2.dilate(_places_to_blocks(touched).astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(grown)
    boxes = [
        (x * BLOCK_PX, y * BLOCK_PX, (x + dx) * BLOCK_PX, (y + dy) * BLOCK_PX) for x, y, dx, dy, _ in stats[1:].tolist()
    ]
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes) > WHOLE_SHARE * h * w:
        return [(slice(0, h), slice(0, w))]
    return [(slice(y0, min(y1, h)), slice(x0, min(x1, w))) for x0, y0, x1, y1 in boxes]


def _places_to_blocks(places: BoolArray) -> BoolArray:
    """Which blocks (h / BLOCK_PX, w / BLOCK_PX), rounded up, hold any of the places (h, w)."""
    h, w = places.shape
    padded = np.pad(places, ((0, -h % BLOCK_PX), (0, -w % BLOCK_PX)))
    rows = np.logical_or.reduce([padded[k::BLOCK_PX] for k in range(BLOCK_PX)])
    return np.asarray(np.logical_or.reduce([rows[:, k::BLOCK_PX] for k in range(BLOCK_PX)]))


def _blocks_to_places(blocks: BoolArray, view: WorkingView) -> BoolArray:
    """The places (h, w) in blocks."""
    h, w = view.radius.shape
    return np.ascontiguousarray(blocks.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)[:h, :w])
