"""Painted lines in an image: bright ridges, the straight lines that they form, and places across predicted lines."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray

# px: lines are searched in images reduced to this longer side.
SEARCH_SIDE_PX = 1280
# px, standard deviations of the smoothing at which ridges are measured: lines 1 to 16 px wide.
RIDGE_SCALES = (1.2, 2.4, 4.8)
# Grey levels by which paint must be brighter than both sides: an eye sees 8 of 255 at an edge.
MIN_CONTRAST = 8.0
# The same at a step: shadows and folds have steps, too, and a bright floor has more of them than paint.
STEP_CONTRAST = 2 * MIN_CONTRAST
# Share of the contrast of a bar that its curvature, times the squared smoothing, keeps where both have about one width.
CURVATURE_SHARE = 0.35
# Degrees and px of a cell in which directed ridge points vote for a line.
ANGLE_STEP, OFFSET_STEP = 1.0, 2.0
# Cells by which the direction of a ridge point may be wrong.
ANGLE_SPREAD = 2
# px from a line, and degrees from its direction, of ridge points that belong to it; lenses bend lines by this much.
LINE_TOLERANCE, DIRECTION_TOLERANCE = 2.5, 7.0
# px: gaps that are closed in a line, and the shortest stretch that counts: letters and limbs are shorter.
MAX_GAP, MIN_RUN = 8, 24
# Number of lines that are kept, the longest first: a court has 12, and stands, banners and overlays more than it.
MAX_LINES = 72
# Number of peaks of the votes that are examined: most are of letters and stands, and form no line.
MAX_PEAKS = 1500
# Directions in which maps of ridge points are kept, and the neighbours that each accepts.
MAP_DIRECTIONS = 18
# px from a ridge within which a predicted line is confirmed.
MAP_TOLERANCE = 3
# px beyond paint up to which blur carries its light, and width of the ground that is measured on either side.
BLUR_PX, SIDE_PX = 2.5, 1.5
# px^2, variance of the blur of a usual camera, pixel and interpolation; it moves the first moment of a step.
BLUR_VARIANCE = 0.8
# px on either side of a step over which brightness is compared.
STEP_SIDE_PX = 2.0
# Share of the contrast by which the grounds beside paint differ before they shift its centroid by a tenth of a px.
UNEVEN_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class RidgePoints:
    """Points on the crests of bright ridges."""

    xy: FloatArray
    """(K, 2) px, sub-pixel."""
    angle: FloatArray
    """(K,) rad, direction across the ridge, in [0, pi)."""


@dataclass(frozen=True, slots=True)
class PaintedLines:
    """Straight lines of ridge points: L lines n . x = offset about the image centre."""

    normal: FloatArray
    """(L, 2) unit vectors."""
    offset: FloatArray
    """(L,) px from the image centre."""
    cover: FloatArray
    """(L, 2 R + 1) px that are painted from one end of the image diagonal to each place -R..R along the line."""

    def lengths_between(self, line: NDArray[np.int64], start: FloatArray, end: FloatArray) -> FloatArray:
        """Measure the painted length, px, of lines between places along them, px from the foot of the centre."""
        radius = (self.cover.shape[1] - 1) // 2
        low, high = (np.clip(np.rint(place), -radius, radius).astype(np.int64) + radius for place in (start, end))
        return np.asarray(np.abs(self.cover[line, high] - self.cover[line, low]))


def convert_to_brightness(image: ImageArray) -> NDArray[np.float32]:
    """Compute the mean of the three channels (H, W): paint may be pink, and grass bright in green."""
    return np.asarray(cv2.transform(image, np.full((1, 3), 1 / 3, np.float32)).astype(np.float32))


def find_ridge_points(brightness: NDArray[np.float32]) -> RidgePoints:
    """Find the crests of bright ridges (Steger 1998, IEEE TPAMI 20, 113).

    Args:
        brightness: (H, W) grey levels.
    """
    crests, angles = [], []
    for scale in RIDGE_SCALES:
        smooth = cv2.GaussianBlur(brightness, (0, 0), scale)
        gx, gy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1)))
        xx, yy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / 4) for order in ((2, 0), (0, 2)))
        xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=1 / 4)
        bend = (xx + yy) / 2 - np.sqrt((xx - yy) ** 2 / 4 + xy**2)
        # Each scale has crests of its own: a coarse one sees a line beside an edge elsewhere, or not at all.
        y, x = np.nonzero(-(scale**2) * bend > CURVATURE_SHARE * MIN_CONTRAST)
        bend, gradient = bend[y, x], np.column_stack([gx[y, x], gy[y, x]])
        angle = np.arctan2(bend - xx[y, x], xy[y, x] + np.float32(1e-9))
        across = np.column_stack([np.cos(angle), np.sin(angle)])
        step = -(gradient * across).sum(1) / bend
        is_crest = np.abs(step) <= 0.6
        crests.append((np.column_stack([x, y]) + step[:, None] * across)[is_crest])
        angles.append(angle[is_crest])
    xy_crest, theta = np.concatenate(crests).astype(np.float64), np.concatenate(angles).astype(np.float64)
    return RidgePoints(xy_crest, np.mod(theta, np.pi))


def find_painted_lines(points: RidgePoints, shape: tuple[int, int]) -> PaintedLines:
    """Find the longest straight lines of ridge points by voting, the strongest first.

    Args:
        points: ridge points of an image.
        shape: its height and width, px.
    """
    middle, radius = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2]), int(np.hypot(*shape) / 2) + 1
    order = np.argsort(points.angle, kind="stable")
    xy, angle = points.xy[order] - middle, points.angle[order]
    bins, cells = round(180 / ANGLE_STEP), 2 * int(radius / OFFSET_STEP) + 3
    column = np.rint(np.degrees(angle) / ANGLE_STEP).astype(np.int64)[:, None] + np.arange(
        -ANGLE_SPREAD, ANGLE_SPREAD + 1
    )
    theta = np.radians(column * ANGLE_STEP)
    rho = xy[:, :1] * np.cos(theta) + xy[:, 1:] * np.sin(theta)
    # Half a turn reverses the normal.
    rho = np.where((column >= 0) & (column < bins), rho, -rho)
    cell = (column % bins) * cells + np.rint(rho / OFFSET_STEP).astype(np.int64) + cells // 2
    votes = np.bincount(cell.ravel(), minlength=bins * cells)
    free = np.ones(len(xy), np.bool_)
    normals, offsets, covers = list[FloatArray](), list[float](), list[FloatArray]()
    for _ in range(MAX_PEAKS):
        peak = int(np.argmax(votes))
        if len(normals) == MAX_LINES or votes[peak] < MIN_RUN:
            break
        votes[np.clip(peak + np.array([-cells, -1, 0, 1, cells]), 0, len(votes) - 1)] = 0
        direction, offset = np.radians(peak // cells * ANGLE_STEP), (peak % cells - cells // 2) * OFFSET_STEP
        line = _fit_line(xy, angle, free, (direction, offset), radius)
        if line is None:
            continue
        normal, offset, cover, members = line
        free[members] = False
        votes -= np.bincount(cell[members].ravel(), minlength=len(votes))
        normals.append(normal)
        offsets.append(offset)
        covers.append(cover)
    longest = np.argsort([-cover[-1] for cover in covers], kind="stable")
    stack = (np.array(normals).reshape(-1, 2), np.array(offsets), np.array(covers).reshape(-1, 2 * radius + 1))
    return PaintedLines(*(part[longest] for part in stack))


def _fit_line(
    xy: FloatArray, angle: FloatArray, free: NDArray[np.bool_], guess: tuple[float, float], radius: int
) -> tuple[FloatArray, float, FloatArray, NDArray[np.int64]] | None:
    """Fit a line to the free points near a guess; None where they form no run.

    Returns:
        Normal (2,), offset, painted length up to each place (2 R + 1), and the points that belong to it.
    """
    direction, offset = guess
    for _ in range(2):
        normal = np.array([np.cos(direction), np.sin(direction)])
        # Angles are sorted; those near half a turn are near 0 as well.
        limits = np.mod(direction + np.radians([-DIRECTION_TOLERANCE, DIRECTION_TOLERANCE]), np.pi)
        low, high = np.searchsorted(angle, limits)
        near = np.arange(low, high) if low <= high else np.r_[0:high, low : len(angle)]
        members = near[free[near] & (np.abs(xy[near] @ normal - offset) < LINE_TOLERANCE)]
        along = np.rint(xy[members] @ np.array([-normal[1], normal[0]])).astype(np.int64) + radius
        painted = np.zeros((1, 2 * radius + 1), np.uint8)
        painted[0, np.clip(along, 0, 2 * radius)] = 1
        painted = cv2.morphologyEx(painted, cv2.MORPH_CLOSE, np.ones((1, MAX_GAP + 1), np.uint8))
        painted = cv2.morphologyEx(painted, cv2.MORPH_OPEN, np.ones((1, MIN_RUN), np.uint8))[0]
        members = members[painted[np.clip(along, 0, 2 * radius)] > 0]
        if len(members) < MIN_RUN // 2:
            return None
        mean = xy[members].mean(0)
        across = np.linalg.svd(xy[members] - mean, full_matrices=False)[2][1]
        # Places along the line keep their direction.
        normal = across if across @ normal > 0 else -across
        direction, offset = float(np.arctan2(normal[1], normal[0])), float(normal @ mean)
    return normal, offset, np.cumsum(painted, dtype=np.float64), members


def map_ridge_directions(points: RidgePoints, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Map where ridges of each direction are near (MAP_DIRECTIONS, H, W)."""
    maps = np.zeros((MAP_DIRECTIONS, *shape), np.uint8)
    x, y = (np.clip(np.rint(points.xy[:, k]).astype(np.int64), 0, shape[1 - k] - 1) for k in (0, 1))
    direction = np.rint(points.angle / np.pi * MAP_DIRECTIONS).astype(np.int64)
    for turn in (-1, 0, 1):
        maps[(direction + turn) % MAP_DIRECTIONS, y, x] = 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MAP_TOLERANCE + 1,) * 2)
    return np.stack([cv2.dilate(one, kernel) for one in maps]).astype(np.bool_)


def measure_crests(
    brightness: NDArray[np.float32],
    xy: FloatArray,
    normal: FloatArray,
    width: FloatArray,
    reach: float,
    is_width_known: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """Measure where paint lies across predicted lines.

    Args:
        brightness: (H, W) grey levels.
        xy: (K, 2) px, predicted places of the centre of the paint.
        normal: (K, 2) unit vectors across the lines.
        width: (K,) px, of the paint.
        reach: px across, up to which paint is searched.
        is_width_known: (K,) whether widths are exact, not only about right.

    Returns:
        (K,) px along the normal from the prediction to the paint, NaN where there is none, and (K,) its contrast with
        the brighter side.
    """
    if len(xy) == 0:
        return np.empty(0), np.empty(0)
    extent = int(np.ceil(reach + np.max(width) / 2 + BLUR_PX + SIDE_PX)) + 1
    s, profile = _sample_across(brightness, xy, normal, 2 * extent)
    total = np.concatenate([np.zeros((len(xy), 1)), np.cumsum(profile, axis=1, dtype=np.float64)], axis=1)
    core = np.clip(np.rint(width), 1, None).astype(np.int64)
    gap = np.rint(width + 3).astype(np.int64)
    inside = _mean_between(total, -core // 2, core - core // 2)
    left, right = _mean_between(total, -gap - 3, -gap + 1), _mean_between(total, gap, gap + 4)
    contrast = inside - np.maximum(left, right)
    contrast[:, np.abs(s) > reach] = -np.inf
    best = np.argmax(contrast, axis=1)
    rows = np.arange(len(xy))
    peak = contrast[rows, best]
    centre = s[best] + _find_bar_centre(profile, s - s[best][:, None], width, is_width_known)
    height, wide = brightness.shape
    is_inside = ((xy > 2) & (xy < np.array([wide - 3, height - 3]))).all(1)
    is_paint = is_inside & (peak > MIN_CONTRAST) & (np.abs(centre) < reach)
    return np.where(is_paint, centre, np.nan), np.where(is_inside, peak, -np.inf)


def measure_steps(
    brightness: NDArray[np.float32], xy: FloatArray, outward: FloatArray, width: FloatArray, reach: float
) -> FloatArray:
    """Measure where thin paint lies that merges with a ground behind it which is as bright: the image rises to both.

    Args:
        brightness: (H, W) grey levels.
        xy: (K, 2) px, predicted places of the centre of the paint.
        outward: (K, 2) unit vectors from the darker ground to the other.
        width: (K,) px, of the paint.
        reach: px across, up to which the step is searched.

    Returns:
        (K,) px outward from the prediction to the centre of the paint; NaN where there is no step.
    """
    if len(xy) == 0:
        return np.empty(0)
    cells = round(2 * STEP_SIDE_PX)
    extent = int(np.ceil(2 * reach + np.max(width))) + 1 + cells
    s, profile = _sample_across(brightness, xy, outward, extent)
    total = np.cumsum(profile, axis=1, dtype=np.float64)
    # the mean of the cells behind a place less that of those before it
    rise = (total[:, 2 * cells :] - 2 * total[:, cells:-cells] + total[:, : -2 * cells]) / cells
    best = np.clip(np.argmax(rise, axis=1), 1, rise.shape[1] - 2)
    before, peak, after = (rise[np.arange(len(xy)), best + k] for k in (-1, 0, 1))
    is_peak = (peak > STEP_CONTRAST) & (peak >= before) & (peak >= after)
    vertex = (before - after) / np.where(is_peak, 2 * (before - 2 * peak + after) - 1e-9, 1.0)
    centre = s[cells:-cells][best] + (0.5 + vertex) / 2 + width / 2
    return np.where(is_peak & (np.abs(centre) < reach), centre, np.nan)


def _sample_across(
    brightness: NDArray[np.float32], xy: FloatArray, normal: FloatArray, cells: int
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Sample the brightness across predicted lines: px along the normal (S,), every half, and grey levels (K, S)."""
    s = np.arange(-cells, cells + 1) / 2
    at = (xy[:, None] + s[:, None] * normal[:, None]).astype(np.float32)
    levels = cv2.remap(brightness, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return s, np.asarray(levels, np.float32)


def _find_bar_centre(
    profile: NDArray[np.float32], off: FloatArray, width: FloatArray, is_width_known: NDArray[np.bool_]
) -> FloatArray:
    """Find the centres (K,), px, of bars of known widths between grounds that may differ, in profiles (K, S) at `off`.

    Area and first moment of a bar and a step, which a blur changes only by its variance, give height and centre.
    """
    reach = width / 2 + BLUR_PX
    inside = np.abs(off) <= reach[:, None]
    beyond = (np.abs(off) > reach[:, None]) & (np.abs(off) <= reach[:, None] + SIDE_PX)
    left, right = (
        (profile * side).sum(1) / np.maximum(side.sum(1), 1) for side in (beyond & (off < 0), beyond & (off > 0))
    )
    rise = right - left
    # Between like grounds, the centroid of what is brighter than both is exact too, and less noisy.
    share = np.clip(off / (2 * reach[:, None]) + 0.5, 0, 1)
    brighter = np.where(np.abs(off) <= width[:, None] / 2 + 1.75, profile - left[:, None] - share * rise[:, None], 0.0)
    brighter = np.maximum(brighter, 0.0)
    centroid = (brighter * off).sum(1) / np.maximum(brighter.sum(1), 1e-9)
    step = 0.5
    excess = np.where(inside, profile - left[:, None], 0.0)
    area, moment = step * excess.sum(1), step * (excess * off).sum(1)
    end = step * inside.sum(1) / 2
    bar = np.maximum(area - rise * end, 1e-9)
    centre = np.zeros(len(profile))
    for _ in range(3):
        centre = (moment - rise * (end**2 / 2 - width**2 / 8 + (centre**2 - BLUR_VARIANCE) / 2)) / bar
        centre = np.clip(centre, -reach, reach)
    is_uneven = np.abs(rise) > UNEVEN_SHARE * brighter.max(1)
    return np.where(is_uneven & is_width_known, centre, centroid)


def _mean_between(total: FloatArray, start: NDArray[np.int64], stop: NDArray[np.int64]) -> FloatArray:
    """Compute means from `start` to before `stop` (K,) places after each place of rows with running totals (K, S+1)."""
    size = total.shape[1] - 1
    place = np.arange(size)
    low = np.clip(place + start[:, None], 0, size)
    high = np.clip(place + stop[:, None], 0, size)
    sums = np.take_along_axis(total, high, 1) - np.take_along_axis(total, low, 1)
    return np.asarray(sums / np.maximum(high - low, 1))
