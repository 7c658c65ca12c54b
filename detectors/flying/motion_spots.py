"""Spots of motion: places that look in one frame as in no neighbouring one, and alone so."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.flying.frame_windows import FrameWindow
from models.core.typing import ByteArray, FloatArray, IntArray

# Sides, working px, of the squares over which a spot and its surroundings are averaged: an object of the radius of
# `LARGEST_RADIUS_PX`, and a player's limb.
SPOT_PX, SURROUNDINGS_PX = 5, 25
# Grey levels of change that 8-bit images contain anyway.
ROUNDING = 2.0
# Least distinctness of a spot. A lone px has 1, pure noise 0.6 and its peaks 1.1.
LEAST_DISTINCTNESS = 1.0
# Side, working px, of the square in which a spot is the strongest.
SEPARATION_PX = 9


@dataclass(frozen=True, slots=True)
class Spots:
    """K spots of a frame, the most distinct first."""

    place: IntArray
    """(K, 2) x and y, working px."""
    distinctness: FloatArray
    """(K,) the change at the spot over that of its surroundings: for a lone object the square root of its area, up to
    the side of the square.
    """


def map_lone_change(window: FrameWindow) -> ByteArray:
    """Map the grey levels (H, W) by which a frame is brighter or darker than both neighbours."""
    image, before, after = window.images[2], window.images[1], window.images[3]
    brighter = cv2.subtract(image, cv2.max(before, after))
    return np.asarray(cv2.add(brighter, cv2.subtract(cv2.min(before, after), image)), np.uint8)


def find_spots(change: ByteArray) -> Spots:
    """Find the spots of a map (H, W) of `map_lone_change`."""
    total = cv2.boxFilter(change, cv2.CV_16U, (SPOT_PX, SPOT_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
    highest = cv2.dilate(total, np.ones((SEPARATION_PX, SEPARATION_PX), np.uint8))
    # Less than one grey level on average cannot exceed the rounding.
    is_peak = cv2.bitwise_and(cv2.compare(total, highest, cv2.CMP_EQ), cv2.compare(total, SPOT_PX**2, cv2.CMP_GT))
    found = cv2.findNonZero(is_peak)
    if found is None:
        return Spots(np.empty((0, 2), np.int64), np.empty(0))
    x, y = found.reshape(-1, 2).T
    power = cv2.sqrBoxFilter(change, cv2.CV_32F, (SURROUNDINGS_PX, SURROUNDINGS_PX), borderType=cv2.BORDER_REFLECT)
    distinctness = total[y, x] / SPOT_PX**2 / np.sqrt(power[y, x] + ROUNDING**2)
    order = np.argsort(-distinctness, kind="stable")
    order = order[distinctness[order] > LEAST_DISTINCTNESS]
    return Spots(np.column_stack([x, y])[order].astype(np.int64), distinctness[order])
