"""Where something other than balls moves between two pictures, and an interpolator at work there alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from video.flow import Between, Interpolator

Picture = NDArray[np.uint8]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]
"""x0, y0, x1, y1"""

COARSE = 4
"""px of the picture per cell of the map of what moves."""
LEAST_CHANGE, NOISE_TIMES = 7.0, 5.0
"""Levels of 255, and times the usual change of a cell (coding, sensor), from which something moves in it."""
MARGIN = 28
"""px around what moves that the interpolator sees: a share of the longest ways of cue and hands."""
FEATHER = 10
"""px over which its picture goes over into the one around."""
MOST_BOXES, MOST_JOINED = 6, 24
"""Boxes that are opened, and that are looked at, the largest ones."""
LEAST_CELLS = 4
"""Cells side by side: fewer are a glint or noise, and dissolve."""
NOT_WORTH = 0.5
"""Share of the picture from which all of it is handed over at once."""


@dataclass(frozen=True, slots=True)
class Region:
    """A box of the picture, what happens in it, and how far that counts at each pixel."""

    box: Box
    between: Between
    weight: Singles
    """(h, w) 0 to 1; 0 at borders inside the picture."""

    def lay(self, picture: Picture, share: float) -> None:
        """Put the picture of a share of the time over `picture` (H, W, 3), in place."""
        x0, y0, x1, y1 = self.box
        ground = picture[y0:y1, x0:x1]
        ground[:] = cv2.blendLinear(np.ascontiguousarray(ground), self.between(share), 1 - self.weight, self.weight)


def open_regions(first: Picture, second: Picture, interpolator: Interpolator) -> tuple[Region, ...]:
    """Find what moves between two pictures (H, W, 3) without moving balls, and open it."""
    stirred = find_stirred(first, second)
    regions = []
    for box in _boxes(stirred, first.shape):
        x0, y0, x1, y1 = box
        here = np.s_[y0:y1, x0:x1]
        between = interpolator.open(np.ascontiguousarray(first[here]), np.ascontiguousarray(second[here]))
        regions.append(Region(box, between, _weight(stirred, box, first.shape)))
    return tuple(regions)


def find_stirred(first: Picture, second: Picture) -> Mask:
    """(H / COARSE, W / COARSE) cells in which more than noise tells the two pictures apart."""
    height, width = first.shape[:2]
    size = (max(1, width // COARSE), max(1, height // COARSE))
    small = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in (first, second)]
    change = np.asarray(cv2.absdiff(*small)).max(axis=2).astype(np.float32)
    usual = float(np.median(change))
    stirred = (change > LEAST_CHANGE + NOISE_TIMES * usual).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(stirred, connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= LEAST_CELLS
    large[0] = False
    return np.asarray(large[labels])


def _boxes(stirred: Mask, shape: tuple[int, ...]) -> list[Box]:
    """Boxes around what moves, with their margins, apart from each other."""
    if not stirred.any():
        return []
    reach = 2 * (MARGIN // COARSE) + 1
    grown = cv2.dilate(stirred.astype(np.uint8), np.ones((reach, reach), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8)
    boxes = _joined([_scaled(row, shape) for row in stats[1:, :4]])
    everything = (0, 0, shape[1], shape[0])
    if sum(_area(box) for box in boxes) > NOT_WORTH * _area(everything):
        return [everything]
    return boxes


def _scaled(cells: NDArray[np.int32], shape: tuple[int, ...]) -> Box:
    x, y, width, height = (int(v) * COARSE for v in cells)
    right, bottom = x + width + COARSE, y + height + COARSE
    return x, y, min(right, shape[1]), min(bottom, shape[0])


def _joined(boxes: list[Box]) -> list[Box]:
    """Boxes that overlap become one, until none do; and where there are too many, those that waste least."""
    boxes = sorted(boxes, key=_area)[-MOST_JOINED:]
    while True:
        pairs = [(_area(_hull([a, b])) - _area(a) - _area(b), a, b) for a, b in combinations(boxes, 2)]
        meeting = [pair for pair in pairs if _overlap(*pair[1:])]
        if not meeting and len(boxes) <= MOST_BOXES:
            return boxes
        _, a, b = min(meeting or pairs)
        boxes = [box for box in boxes if box not in (a, b)] + [_hull([a, b])]


def _hull(boxes: list[Box]) -> Box:
    corners = np.array(boxes)
    x0, y0 = (int(v) for v in corners[:, :2].min(axis=0))
    x1, y1 = (int(v) for v in corners[:, 2:].max(axis=0))
    return x0, y0, x1, y1


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _area(box: Box) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _weight(stirred: Mask, box: Box, shape: tuple[int, ...]) -> Singles:
    """(h, w): 1 around what moves, falling to 0 before the borders of the box that are no borders of the picture."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    reach = 2 * (MARGIN // 2 // COARSE) + 1
    grown = cv2.dilate(stirred.astype(np.uint8), np.ones((reach, reach), np.uint8)).astype(np.float32)
    cells = grown[y0 // COARSE : -(-y1 // COARSE), x0 // COARSE : -(-x1 // COARSE)]
    wide = cv2.blur(cv2.resize(cells, (width, height), interpolation=cv2.INTER_LINEAR), (FEATHER, FEATHER))
    across, down = _ramp(x0, x1, shape[1]), _ramp(y0, y1, shape[0])
    wide = wide * across[None] * down[:, None]
    return np.ascontiguousarray(wide, dtype=np.float32)


def _ramp(low: int, high: int, end: int) -> Singles:
    """(high - low,) from 0 at both borders to 1, but where a border is that of the picture."""
    place = np.arange(high - low, dtype=np.float32)
    inner = np.full(len(place), np.float32(FEATHER))
    before, behind = (inner if low == 0 else place), (inner if high == end else place[::-1])
    return np.asarray(np.clip(np.minimum(before, behind) / FEATHER, 0, 1), dtype=np.float32)
