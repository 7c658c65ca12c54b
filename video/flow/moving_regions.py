"""Where something other than balls moves between two pictures, and an interpolator at work there alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import BoolArray, Float32Array, FloatArray, ImageArray
from video.flow.optical_flow import Between, Interpolator
from video.io.pixel_kernels import CELL as COARSE
from video.io.pixel_kernels import fill_cells

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1"""
Part = tuple[Box, tuple[int, ...]]
"""A box and the numbers of the things that move in it."""

LEAST_CHANGE, NOISE_TIMES = 7.0, 5.0
"""Levels of 255, and times the usual change of a cell (coding, sensor), from which something moves in it."""
SLACK = 2
"""px by which an edge may be off where the camera moves: even."""
MARGIN = 28
"""px around what moves that the interpolator sees: a share of the longest ways of cue and hands."""
FEATHER = 10
"""px over which its picture goes over into the one around."""
MOST_BOXES, MOST_JOINED = 6, 24
"""Boxes that are opened, and that are looked at, the largest ones."""
WORTH_A_CUT = 0.7
"""Share of one box that two may hold to be worth a cut."""
WASTED = 0.2
"""Share by which the box around two boxes may be larger than both: then they are one."""
LEAST_CELLS = 4
"""Cells side by side: fewer are a glint or noise, and dissolve."""
NOT_WORTH = 0.5
"""Share of the picture from which all of it is handed over at once."""


@dataclass(frozen=True, slots=True)
class Region:
    """A box of the picture, what happens in it, and how far that counts at each pixel."""

    box: Box
    between: Between
    weight: Float32Array
    """(h, w) 0 to 1; 0 at borders inside the picture."""

    def lay(self, picture: ImageArray, share: float, moved: FloatArray | None = None) -> None:
        """Put the picture of a share of the time over `picture` (H, W, 3), in place.

        `moved` (3, 3) takes pixels in which the box is meant to those of `picture`, where the camera moves.
        """
        box, patch, weight = self.box, self.between(share), self.weight
        if moved is not None:
            box, patch, weight = _carried(box, patch, weight, moved, picture.shape)
        x0, y0, x1, y1 = box
        if x1 > x0 and y1 > y0:
            ground = picture[y0:y1, x0:x1]
            ground[:] = cv2.blendLinear(np.ascontiguousarray(ground), patch, 1 - weight, weight)


def _carried(
    box: Box, patch: ImageArray, weight: Float32Array, moved: FloatArray, shape: tuple[int, ...]
) -> tuple[Box, ImageArray, Float32Array]:
    """A patch (h, w, 3) in a box and its weight (h, w) as another picture has them, cut at its borders."""
    x0, y0, x1, y1 = box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=np.float64)
    there = apply_homography(moved, corners)
    left, top = (int(v) for v in np.maximum(np.floor(there.min(axis=0)), 0))
    right, bottom = (int(v) for v in np.minimum(np.ceil(there.max(axis=0)) + 1, [shape[1], shape[0]]))
    size = (max(right - left, 0), max(bottom - top, 0))
    if 0 in size:
        return (0, 0, 0, 0), patch, weight
    step = _shift(-left, -top) @ moved @ _shift(x0, y0)
    seen = cv2.warpPerspective(patch, step, size, borderMode=cv2.BORDER_REPLICATE)
    counts = cv2.warpPerspective(weight, step, size, borderMode=cv2.BORDER_CONSTANT)
    return (left, top, right, bottom), np.asarray(seen, dtype=np.uint8), np.asarray(counts, dtype=np.float32)


def _shift(x: float, y: float) -> FloatArray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def open_regions(
    first: ImageArray,
    second: ImageArray,
    interpolator: Interpolator,
    steady: bool = True,
    small: tuple[ImageArray, ImageArray] | None = None,
) -> tuple[Region, ...]:
    """Find what moves between two pictures (H, W, 3) without moving balls, and open it.

    Where the camera is not `steady` and the second was brought over the first, edges are off by a pixel here and there:
    what lies above or below the table moves otherwise. That alone is no motion. Of a steady one the `coarse` pictures
    may be given, where they are known.
    """
    stirred = find_stirred(first, second, steady, small)
    regions = []
    for box, cells in _boxes(stirred, first.shape):
        x0, y0, x1, y1 = box
        here = np.s_[y0:y1, x0:x1]
        between = interpolator.open(np.ascontiguousarray(first[here]), np.ascontiguousarray(second[here]))
        regions.append(Region(box, between, _weight(cells, box, first.shape)))
    return tuple(regions)


def coarse(picture: ImageArray) -> ImageArray:
    """(H / COARSE, W / COARSE[, 3]) The mean of every cell."""
    height, width = (max(1, side // COARSE) for side in picture.shape[:2])
    if picture.shape == (COARSE * height, COARSE * width, 3) and picture.flags.c_contiguous:
        cells = np.empty((height, width, 3), dtype=np.uint8)
        fill_cells(picture, cells)
        return cells
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def find_stirred(
    first: ImageArray, second: ImageArray, steady: bool = True, small: tuple[ImageArray, ImageArray] | None = None
) -> BoolArray:
    """(H / COARSE, W / COARSE) cells in which more than noise tells the two pictures apart; see `open_regions`."""
    if steady:
        change = _largest(cv2.absdiff(*(small or (coarse(first), coarse(second))))).astype(np.float32)
    else:
        size = (max(1, first.shape[1] // COARSE), max(1, first.shape[0] // COARSE))
        change = cv2.resize(_beyond_edges(first, second), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    usual = float(np.median(change))
    stirred = (change > LEAST_CHANGE + NOISE_TIMES * usual).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(stirred, connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= LEAST_CELLS
    large[0] = False
    return np.asarray(large[labels])


def _largest(levels: ImageArray) -> ImageArray:
    """(h, w) of (h, w, 3), a tenth of the time of an array's own."""
    red, green, blue = cv2.split(levels)
    return np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.uint8)


def _beyond_edges(first: ImageArray, second: ImageArray) -> ImageArray:
    """(H / 2, W / 2) levels by which no colour within SLACK px of the one picture is that of the other."""
    halves = [cv2.resize(p, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for p in (first, second)]
    around = np.ones((SLACK + 1, SLACK + 1), np.uint8)
    low, high = cv2.erode(halves[0], around), cv2.dilate(halves[0], around)
    apart = cv2.max(cv2.subtract(halves[1], high), cv2.subtract(low, halves[1]))
    return _largest(apart)


def _boxes(stirred: BoolArray, shape: tuple[int, ...]) -> list[tuple[Box, BoolArray]]:
    """Boxes around what moves, with their margins, and the cells that move in each; they may overlap."""
    if not stirred.any():
        return []
    reach = 2 * (MARGIN // COARSE) + 1
    grown = cv2.dilate(stirred.astype(np.uint8), np.ones((reach, reach), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8)
    largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:MOST_JOINED]
    things = [piece for label in largest for piece in _pieces(stirred & (labels == label))]
    parts = _joined([(_box_of(cells, shape), (k,)) for k, cells in enumerate(things)])
    everything = (0, 0, shape[1], shape[0])
    if sum(_area(box) for box, _ in parts) > NOT_WORTH * _area(everything):
        return [(everything, stirred)]
    return [(box, np.logical_or.reduce([things[k] for k in mine])) for box, mine in parts]


def _pieces(cells: BoolArray) -> list[BoolArray]:
    """What hangs together, cut across where two boxes hold much less than one: a player beside a line of text."""
    upper, lower = (_areas(cells), _areas(cells[::-1])[::-1])
    left, right = (_areas(cells.T), _areas(cells.T[::-1])[::-1])
    down, across = upper[:-1] + lower[1:], left[:-1] + right[1:]
    if not len(down) or not len(across) or min(down.min(), across.min()) > WORTH_A_CUT * upper[-1]:
        return [cells]
    first = np.zeros_like(cells)
    if down.min() <= across.min():
        first[: int(down.argmin()) + 1] = True
    else:
        first[:, : int(across.argmin()) + 1] = True
    return [*_pieces(cells & first), *_pieces(cells & ~first)]


def _areas(cells: BoolArray) -> NDArray[np.int64]:
    """(rows,) of the box, with its margins, around all cells down to each row."""
    margin, rows = 2 * (MARGIN // COARSE), np.flatnonzero(cells.any(axis=1))
    so_far = np.logical_or.accumulate(cells, axis=0)
    wide = np.where(so_far.any(axis=1), cells.shape[1] - so_far[:, ::-1].argmax(axis=1) - so_far.argmax(axis=1), 0)
    last = np.maximum.accumulate(np.where(cells.any(axis=1), np.arange(len(cells)), -1))
    return np.where(last < 0, 0, (last - rows[0] + 1 + margin) * (wide + margin))


def _box_of(cells: BoolArray, shape: tuple[int, ...]) -> Box:
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    margin = MARGIN // COARSE
    left, top = (max(int(line[0]) - margin, 0) * COARSE for line in (columns, rows))
    right, bottom = ((int(line[-1]) + 1 + margin) * COARSE for line in (columns, rows))
    # cells leave out what is left of a picture whose sides are no multiples of theirs
    right, bottom = (end if whole - end >= COARSE else whole for end, whole in ((right, shape[1]), (bottom, shape[0])))
    return left, top, min(right, shape[1]), min(bottom, shape[0])


def _joined(parts: list[Part]) -> list[Part]:
    """Boxes with what lies in them; two become one where that wastes little, and while there are too many.

    Boxes that overlap stay apart otherwise: what crawls along two sides of a picture is not all of it.
    """
    parts = sorted(parts, key=lambda part: _area(part[0]))[-MOST_JOINED:]
    while len(parts) > 1:
        pairs = [(_wasted(a[0], b[0]), a, b) for a, b in combinations(parts, 2)]
        wasted, a, b = min(pairs)
        if wasted > WASTED * (_area(a[0]) + _area(b[0])) and len(parts) <= MOST_BOXES:
            break
        parts = [part for part in parts if part not in (a, b)] + [(_hull(a[0], b[0]), a[1] + b[1])]
    return parts


def _wasted(a: Box, b: Box) -> int:
    """px of the box around two boxes beyond the px of both; below 0 where they overlap."""
    return _area(_hull(a, b)) - _area(a) - _area(b)


def _hull(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _area(box: Box) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _weight(stirred: BoolArray, box: Box, shape: tuple[int, ...]) -> Float32Array:
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


def _ramp(low: int, high: int, end: int) -> Float32Array:
    """(high - low,) from 0 at both borders to 1, but where a border is that of the picture."""
    place = np.arange(high - low, dtype=np.float32)
    inner = np.full(len(place), np.float32(FEATHER))
    before, behind = (inner if low == 0 else place), (inner if high == end else place[::-1])
    return np.asarray(np.clip(np.minimum(before, behind) / FEATHER, 0, 1), dtype=np.float32)
