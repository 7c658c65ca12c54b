"""Spots of motion: places that look in one frame as in no neighbouring one, and alone so."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.flying.frame_windows import MIDDLE_IMAGE, FrameWindow
from detectors.flying.object_size import is_inside
from detectors.flying.spot_patches import cut_squares
from models.core.typing import BoolArray, ByteArray, FloatArray, IntArray

# Change is mapped in cells of 2 px, in which video stores colour.
CELL_PX = 2
# Side, cells, of the square over which a spot is averaged, an object of the radius of `LARGEST_RADIUS_PX`; and the
# number of such squares across its surroundings, a player's limb.
SPOT_CELLS, SURROUNDINGS = 3, 5
# Levels of change that 8-bit images contain anyway.
ROUNDING = 2.0
# Least distinctness of a spot. A lone cell has 1.7, pure noise 0.8 to 0.9, and its peaks 1.1.
LEAST_DISTINCTNESS = 1.0
# Side, cells, of the square in which a spot is the strongest.
SEPARATION_CELLS = 5
# Share of its change against the far neighbours, which are moved onto the frame, below which what changes less against
# neighbours that are not moved is a caption: it stands still in the frame rather than in the scene.
CAPTION_SHARE = 0.5
# Spots of either map that are judged: the object is among them where it can be told from noise.
SPOTS_PER_MAP = 30


@dataclass(frozen=True, slots=True)
class Spots:
    """K spots of a frame, the most distinct first."""

    place: IntArray
    """(K, 2) x and y, working px, in the middle of cells."""
    distinctness: FloatArray
    """(K,) the change at the spot over that of its surroundings: for a lone object it grows with the square root of its
    area, up to that of the square.
    """


def find_window_spots(window: FrameWindow, outline: FloatArray | None) -> IntArray:
    """Find the spots (K, 2) of a frame inside a convex outline (V, 2), working px, the most distinct first.

    Near neighbours show a fast object before a player; far ones a slow one, which covers its own place in the near
    ones. Spots of the near ones come first.
    """
    near, far = (find_spots(map_lone_change(window, step)).place for step in (1, 3))
    near, far = (place[is_inside(outline, place.astype(np.float64))] for place in (near, far))
    if window.is_moving:
        near, far = (place[~_is_caption(window, place)] for place in (near, far))
    near, far = near[:SPOTS_PER_MAP], far[:SPOTS_PER_MAP]
    reach = CELL_PX * SEPARATION_CELLS
    is_new = np.abs(far[:, None] - near).max(axis=2).min(axis=1, initial=reach) > reach // 2
    return np.concatenate([near, far[is_new]])


def _is_caption(window: FrameWindow, place: IntArray) -> BoolArray:
    """Return which spots (K, 2) stand still in the frame although the camera moves."""
    square = np.array([cut_squares(image.luma, place, CELL_PX * SPOT_CELLS) for image in window.images], np.int16)
    change = np.abs(square - square[MIDDLE_IMAGE]).mean(axis=(2, 3))
    return np.asarray(change[[1, 5]].max(axis=0) < CAPTION_SHARE * change[[0, 6]].min(axis=0))


def map_lone_change(window: FrameWindow, step: int = 1) -> ByteArray:
    """Map by how many levels (H/2, W/2) a frame differs from both images so many places beside it, to the same side.

    Levels of luma and chroma are added: a ball may be as bright as the court, and a shuttle of its colour.
    """
    image, before, after = (window.images[MIDDLE_IMAGE + k] for k in (0, -step, step))
    luma = _map_excess(image.luma, before.luma, after.luma)
    # The largest of a cell: a ball of 3 px covers most of its cells in part.
    largest = cv2.dilate(luma, np.ones((CELL_PX, CELL_PX), np.uint8), anchor=(0, 0))
    chroma = cv2.transform(_map_excess(image.chroma, before.chroma, after.chroma), np.ones((1, 2)))
    size = (chroma.shape[1], chroma.shape[0])
    return np.asarray(cv2.add(cv2.resize(largest, size, interpolation=cv2.INTER_NEAREST), chroma), np.uint8)


def _map_excess(plane: ByteArray, before: ByteArray, after: ByteArray) -> ByteArray:
    """Map by how much a plane is above or below both others."""
    above = cv2.subtract(plane, cv2.max(before, after))
    return np.asarray(cv2.add(above, cv2.subtract(cv2.min(before, after), plane)), np.uint8)


def find_spots(change: ByteArray) -> Spots:
    """Find the spots of a map (H/2, W/2) of `map_lone_change`."""
    square = (SPOT_CELLS, SPOT_CELLS)
    total = cv2.boxFilter(change, cv2.CV_16U, square, normalize=False, borderType=cv2.BORDER_CONSTANT)
    highest = cv2.dilate(total, np.ones((SEPARATION_CELLS, SEPARATION_CELLS), np.uint8))
    # Less than one level on average cannot exceed the rounding.
    is_peak = cv2.bitwise_and(cv2.compare(total, highest, cv2.CMP_EQ), cv2.compare(total, SPOT_CELLS**2, cv2.CMP_GT))
    peaks = cv2.findNonZero(is_peak)
    if peaks is None:
        return Spots(np.empty((0, 2), np.int64), np.empty(0))
    x, y = peaks.reshape(-1, 2).T
    # Over whole squares: an average over all cells of the surroundings takes longer.
    squares = cv2.multiply(change, change, dtype=cv2.CV_16U)
    size = (-(-change.shape[1] // SPOT_CELLS), -(-change.shape[0] // SPOT_CELLS))
    power = cv2.blur(
        cv2.resize(squares, size, interpolation=cv2.INTER_AREA).astype(np.float32), (SURROUNDINGS, SURROUNDINGS)
    )
    distinctness = total[y, x] / SPOT_CELLS**2 / np.sqrt(power[y // SPOT_CELLS, x // SPOT_CELLS] + ROUNDING**2)
    order = np.argsort(-distinctness, kind="stable")
    order = order[distinctness[order] > LEAST_DISTINCTNESS]
    return Spots(CELL_PX * np.column_stack([x, y])[order].astype(np.int64), distinctness[order])
