"""Regions where something other than balls moves between two frames; interpolation runs only there."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import BoolArray, Float32Array, FloatArray, ImageArray
from video.flow.optical_flow import FlowPair, prepare_flow

# x0, y0, x1, y1
Box = tuple[int, int, int, int]
# A box and the indices of the components that it holds.
Part = tuple[Box, tuple[int, ...]]

# Side of a cell, px.
CELL_PX = 4
# Levels of 255, and multiple of the typical change of a cell (coding and sensor noise), above which a cell moves.
MIN_CHANGE, NOISE_FACTOR = 7.0, 5.0
# px, an even number: displacement of edges that is tolerated where the camera moves.
EDGE_TOLERANCE_PX = 2
# px around the moving cells that the optical flow receives: a share of the longest displacements of cue and hands.
MARGIN_PX = 28
# px over which the interpolated region fades into its surroundings.
FEATHER_PX = 10
# Boxes that are interpolated, and the largest ones that are considered.
MAX_BOXES, MAX_CANDIDATE_BOXES = 6, 24
# A component is split where two boxes together have at most this share of the area of one box.
MAX_SPLIT_AREA_SHARE = 0.7
# Two boxes merge where their common box is larger than both by at most this share.
MAX_EXTRA_AREA_SHARE = 0.2
# Connected cells; fewer are glints or noise, and the cross-fade handles them.
MIN_CELLS = 4
# Share of the frame above which the whole frame becomes one box.
MAX_BOXED_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class MovingRegion:
    """A box of the frame, the flow in it, and the weight of the interpolated content at each pixel."""

    box: Box
    flow: FlowPair
    weight: Float32Array
    """(h, w) 0 to 1; 0 at borders that lie inside the frame."""

    def blend_onto(self, image: ImageArray, share: float, camera_step: FloatArray | None = None) -> None:
        """Blend the interpolated content at a share of the gap onto `image` (H, W, 3), in place.

        `camera_step` (3, 3) maps pixels of the first frame to those of `image` where the camera moves.
        """
        box, patch, weight = self.box, self.flow.interpolate(share), self.weight
        if camera_step is not None:
            box, patch, weight = _warp_patch(box, patch, weight, camera_step, image.shape)
        x0, y0, x1, y1 = box
        if x1 > x0 and y1 > y0:
            target = image[y0:y1, x0:x1]
            target[:] = cv2.blendLinear(np.ascontiguousarray(target), patch, 1 - weight, weight)


def _warp_patch(
    box: Box, patch: ImageArray, weight: Float32Array, camera_step: FloatArray, shape: tuple[int, ...]
) -> tuple[Box, ImageArray, Float32Array]:
    """Warp a patch (h, w, 3) and its weight (h, w) by a homography into an image of another view.

    Returns the box, cut at the border, the patch and the weight there.
    """
    x0, y0, x1, y1 = box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=np.float64)
    warped_corners = apply_homography(camera_step, corners)
    left, top = (int(v) for v in np.maximum(np.floor(warped_corners.min(axis=0)), 0))
    right, bottom = (int(v) for v in np.minimum(np.ceil(warped_corners.max(axis=0)) + 1, [shape[1], shape[0]]))
    size = (max(right - left, 0), max(bottom - top, 0))
    if 0 in size:
        return (0, 0, 0, 0), patch, weight
    step = _translation_matrix(-left, -top) @ camera_step @ _translation_matrix(x0, y0)
    warped = cv2.warpPerspective(patch, step, size, borderMode=cv2.BORDER_REPLICATE)
    warped_weight = cv2.warpPerspective(weight, step, size, borderMode=cv2.BORDER_CONSTANT)
    return (left, top, right, bottom), np.asarray(warped, dtype=np.uint8), np.asarray(warped_weight, dtype=np.float32)


def _translation_matrix(x: float, y: float) -> FloatArray:
    """Return the homography (3, 3) of a translation."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def find_moving_regions(
    first: ImageArray,
    second: ImageArray,
    camera_is_still: bool = True,
    within: BoolArray | None = None,
) -> tuple[MovingRegion, ...]:
    """Find the regions in which something moves between two frames, and prepare their interpolation.

    Where the camera moves and the second frame was warped onto the first, edges above or below the table are
    displaced by a pixel or so; that alone is no motion.

    Args:
        first: First frame (H, W, 3) without its moving balls.
        second: Second frame (H, W, 3) without its moving balls, in the pixels of the first.
        camera_is_still: False if the second frame was warped.
        within: Pixels (H, W) in which motion counts; None for all.

    Returns:
        The regions, which may overlap.
    """
    moving_cells = find_moving_cells(first, second, camera_is_still)
    if within is not None:
        rows, columns = moving_cells.shape
        moving_cells &= within[: rows * CELL_PX : CELL_PX, : columns * CELL_PX : CELL_PX]
    regions = []
    for box, cells in _find_boxes(moving_cells, first.shape):
        x0, y0, x1, y1 = box
        here = np.s_[y0:y1, x0:x1]
        between = prepare_flow(np.ascontiguousarray(first[here]), np.ascontiguousarray(second[here]))
        regions.append(MovingRegion(box, between, _blend_weight(cells, box, first.shape)))
    return tuple(regions)


def find_moving_cells(first: ImageArray, second: ImageArray, camera_is_still: bool = True) -> BoolArray:
    """Return the cells (H / CELL_PX, W / CELL_PX) in which two frames differ by more than noise.

    The arguments are those of `find_moving_regions`.
    """
    size = (max(1, first.shape[1] // CELL_PX), max(1, first.shape[0] // CELL_PX))
    if camera_is_still:
        halves = (cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in (first, second))
        # in two steps, for one of the whole factor takes longer
        means = (cv2.resize(half, size, interpolation=cv2.INTER_AREA) for half in halves)
        change = _channel_maximum(cv2.absdiff(*means)).astype(np.float32)
    else:
        change = cv2.resize(_change_beyond_edges(first, second), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    typical_change = float(np.median(change))
    is_moving = (change > MIN_CHANGE + NOISE_FACTOR * typical_change).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(is_moving, connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= MIN_CELLS
    large[0] = False
    return np.asarray(large[labels])


def _channel_maximum(levels: ImageArray) -> ImageArray:
    """Return the maximum (h, w) over three channels (h, w, 3), ten times faster than numpy's own."""
    red, green, blue = cv2.split(levels)
    return np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.uint8)


def _change_beyond_edges(first: ImageArray, second: ImageArray) -> ImageArray:
    """Return the levels (H / 2, W / 2) by which one frame leaves the range of the other within the edge tolerance."""
    halves = [cv2.resize(p, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for p in (first, second)]
    neighbourhood = np.ones((EDGE_TOLERANCE_PX + 1, EDGE_TOLERANCE_PX + 1), np.uint8)
    low, high = cv2.erode(halves[0], neighbourhood), cv2.dilate(halves[0], neighbourhood)
    change = cv2.max(cv2.subtract(halves[1], high), cv2.subtract(low, halves[1]))
    return _channel_maximum(change)


def _find_boxes(moving_cells: BoolArray, shape: tuple[int, ...]) -> list[tuple[Box, BoolArray]]:
    """Return boxes with margins around the moving cells, and the moving cells of each; the boxes may overlap."""
    if not moving_cells.any():
        return []
    reach = 2 * (MARGIN_PX // CELL_PX) + 1
    grown = cv2.dilate(moving_cells.astype(np.uint8), np.ones((reach, reach), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(grown, connectivity=8)
    largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:MAX_CANDIDATE_BOXES]
    components = [piece for label in largest for piece in _split_component(moving_cells & (labels == label))]
    parts = _merge_boxes([(_bounding_box(cells, shape), (k,)) for k, cells in enumerate(components)])
    whole_image = (0, 0, shape[1], shape[0])
    if sum(_box_area(box) for box, _ in parts) > MAX_BOXED_SHARE * _box_area(whole_image):
        return [(whole_image, moving_cells)]
    return [(box, np.logical_or.reduce([components[k] for k in members])) for box, members in parts]


def _split_component(cells: BoolArray) -> list[BoolArray]:
    """Split connected cells where two boxes are much smaller than one, as for a player beside a line of text."""
    upper, lower = (_box_areas_by_row(cells), _box_areas_by_row(cells[::-1])[::-1])
    left, right = (_box_areas_by_row(cells.T), _box_areas_by_row(cells.T[::-1])[::-1])
    down, across = upper[:-1] + lower[1:], left[:-1] + right[1:]
    if not len(down) or not len(across) or min(down.min(), across.min()) > MAX_SPLIT_AREA_SHARE * upper[-1]:
        return [cells]
    first = np.zeros_like(cells)
    if down.min() <= across.min():
        first[: int(down.argmin()) + 1] = True
    else:
        first[:, : int(across.argmin()) + 1] = True
    return [*_split_component(cells & first), *_split_component(cells & ~first)]


def _box_areas_by_row(cells: BoolArray) -> NDArray[np.int64]:
    """Return the area (rows,) of the box, with margins, around all cells from the top down to each row."""
    margin, rows = 2 * (MARGIN_PX // CELL_PX), np.flatnonzero(cells.any(axis=1))
    so_far = np.logical_or.accumulate(cells, axis=0)
    wide = np.where(so_far.any(axis=1), cells.shape[1] - so_far[:, ::-1].argmax(axis=1) - so_far.argmax(axis=1), 0)
    last = np.maximum.accumulate(np.where(cells.any(axis=1), np.arange(len(cells)), -1))
    return np.where(last < 0, 0, (last - rows[0] + 1 + margin) * (wide + margin))


def _bounding_box(cells: BoolArray, shape: tuple[int, ...]) -> Box:
    """Return the box of the cells with its margin, px."""
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    margin = MARGIN_PX // CELL_PX
    left, top = (max(int(line[0]) - margin, 0) * CELL_PX for line in (columns, rows))
    right, bottom = ((int(line[-1]) + 1 + margin) * CELL_PX for line in (columns, rows))
    # Cells do not cover the remainder of a frame whose sides are no multiples of the cell size.
    right, bottom = (end if whole - end >= CELL_PX else whole for end, whole in ((right, shape[1]), (bottom, shape[0])))
    return left, top, min(right, shape[1]), min(bottom, shape[0])


def _merge_boxes(parts: list[Part]) -> list[Part]:
    """Merge boxes whose common box is hardly larger than both, and further ones while there are too many.

    Other boxes that overlap stay separate: tickers along two sides of a frame do not fill the whole frame.
    """
    parts = sorted(parts, key=lambda part: _box_area(part[0]))[-MAX_CANDIDATE_BOXES:]
    while len(parts) > 1:
        pairs = [(_extra_area(a[0], b[0]), a, b) for a, b in combinations(parts, 2)]
        wasted, a, b = min(pairs)
        if wasted > MAX_EXTRA_AREA_SHARE * (_box_area(a[0]) + _box_area(b[0])) and len(parts) <= MAX_BOXES:
            break
        parts = [part for part in parts if part not in (a, b)] + [(_enclosing_box(a[0], b[0]), a[1] + b[1])]
    return parts


def _extra_area(a: Box, b: Box) -> int:
    """Return the px by which the enclosing box exceeds both boxes together; negative where they overlap."""
    return _box_area(_enclosing_box(a, b)) - _box_area(a) - _box_area(b)


def _enclosing_box(a: Box, b: Box) -> Box:
    """Return the smallest box that holds two boxes."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _box_area(box: Box) -> int:
    """Return the area of a box, px^2."""
    return (box[2] - box[0]) * (box[3] - box[1])


def _blend_weight(moving_cells: BoolArray, box: Box, shape: tuple[int, ...]) -> Float32Array:
    """Return the weight (h, w): 1 around the moving cells, falling to 0 at box borders that lie inside the frame."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    reach = 2 * (MARGIN_PX // 2 // CELL_PX) + 1
    grown = cv2.dilate(moving_cells.astype(np.uint8), np.ones((reach, reach), np.uint8)).astype(np.float32)
    cells = grown[y0 // CELL_PX : -(-y1 // CELL_PX), x0 // CELL_PX : -(-x1 // CELL_PX)]
    wide = cv2.blur(cv2.resize(cells, (width, height), interpolation=cv2.INTER_LINEAR), (FEATHER_PX, FEATHER_PX))
    across, down = _border_ramp(x0, x1, shape[1]), _border_ramp(y0, y1, shape[0])
    wide = wide * across[None] * down[:, None]
    return np.ascontiguousarray(wide, dtype=np.float32)


def _border_ramp(low: int, high: int, end: int) -> Float32Array:
    """Return a ramp (high - low,) from 0 at both ends to 1 inside, without a ramp at a border of the frame."""
    place = np.arange(high - low, dtype=np.float32)
    flat = np.full(len(place), np.float32(FEATHER_PX))
    from_low, from_high = (flat if low == 0 else place), (flat if high == end else place[::-1])
    return np.asarray(np.clip(np.minimum(from_low, from_high) / FEATHER_PX, 0, 1), dtype=np.float32)
