"""Spots of motion: places that look in one frame as in no neighbouring one, and alone so."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.flying.frame_windows import MIDDLE_IMAGE, FrameWindow
from detectors.flying.object_size import is_inside
from models.core.typing import ByteArray, FloatArray, IntArray

# Side, working px, of the square over which a spot is averaged, an object of the radius of `LARGEST_RADIUS_PX`; and
# the number of such squares across its surroundings, a player's limb.
SPOT_PX, SURROUNDINGS = 5, 5
# Grey levels of change that 8-bit images contain anyway.
ROUNDING = 2.0
# Least distinctness of a spot. A lone px has 1, pure noise 0.6 and its peaks 1.1.
LEAST_DISTINCTNESS = 1.0
# Side, working px, of the square in which a spot is the strongest.
SEPARATION_PX = 9
# Spots of either map that are judged: the object is among them where it can be told from noise.
SPOTS_PER_MAP = 30


@dataclass(frozen=True, slots=True)
class Spots:
    """K spots of a frame, the most distinct first."""

    place: IntArray
    """(K, 2) x and y, working px."""
    distinctness: FloatArray
    """(K,) the change at the spot over that of its surroundings: for a lone object the square root of its area, up to
    the side of the square.
    """


def find_window_spots(window: FrameWindow, outline: FloatArray | None) -> IntArray:
    """Find the spots (K, 2) of a frame inside a convex outline (V, 2), working px, the most distinct first.

    Near neighbours show a fast object before a player; far ones a slow one, which covers its own place in the near
    ones. Spots of the near ones come first.
    """
    near, far = (find_spots(map_lone_change(window, step)).place for step in (1, 3))
    near, far = (place[is_inside(outline, place.astype(np.float64))] for place in (near, far))
    near, far = near[:SPOTS_PER_MAP], far[:SPOTS_PER_MAP]
    is_new = np.abs(far[:, None] - near).max(axis=2).min(axis=1, initial=SEPARATION_PX) > SEPARATION_PX // 2
    return np.concatenate([near, far[is_new]])


def map_lone_change(window: FrameWindow, step: int = 1) -> ByteArray:
    """Map the grey levels (H, W) by which a frame is brighter or darker than both images so many places beside it."""
    image, before, after = (window.images[MIDDLE_IMAGE + k] for k in (0, -step, step))
    brighter = cv2.subtract(image, cv2.max(before, after))
    return np.asarray(cv2.add(brighter, cv2.subtract(cv2.min(before, after), image)), np.uint8)


def find_spots(change: ByteArray) -> Spots:
    """Find the spots of a map (H, W) of `map_lone_change`."""
    total = cv2.boxFilter(change, cv2.CV_16U, (SPOT_PX, SPOT_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
    highest = cv2.dilate(total, np.ones((SEPARATION_PX, SEPARATION_PX), np.uint8))
    # Less than one grey level on average cannot exceed the rounding.
    is_peak = cv2.bitwise_and(cv2.compare(total, highest, cv2.CMP_EQ), cv2.compare(total, SPOT_PX**2, cv2.CMP_GT))
    peaks = cv2.findNonZero(is_peak)
    if peaks is None:
        return Spots(np.empty((0, 2), np.int64), np.empty(0))
    x, y = peaks.reshape(-1, 2).T
    # Squares as cells: an average over all px of the surroundings takes eight times as long.
    squares = cv2.multiply(change, change, dtype=cv2.CV_16U)
    size = (-(-change.shape[1] // SPOT_PX), -(-change.shape[0] // SPOT_PX))
    power = cv2.blur(
        cv2.resize(squares, size, interpolation=cv2.INTER_AREA).astype(np.float32), (SURROUNDINGS, SURROUNDINGS)
    )
    distinctness = total[y, x] / SPOT_PX**2 / np.sqrt(power[y // SPOT_PX, x // SPOT_PX] + ROUNDING**2)
    order = np.argsort(-distinctness, kind="stable")
    order = order[distinctness[order] > LEAST_DISTINCTNESS]
    return Spots(np.column_stack([x, y])[order].astype(np.int64), distinctness[order])
