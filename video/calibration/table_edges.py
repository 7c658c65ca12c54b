"""Lines along the sides of a table: profiles across a side, their steps, and straight lines at sub-pixel precision."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import FloatArray, ImageArray
from models.numerics.robust_scale import estimate_sigma
from video.calibration.camera_model import homography_from_unit_square
from video.calibration.cloth_region import SEARCH_WIDTH_PX, intersect_lines, line_through

USUAL_CUSHION = 0.021
"""Width of a cushion's cloth in table lengths: about 50 mm on 2.54 m."""
CUSHION_RANGE = (0.003, 0.048)
"""Range of apparent cushion widths: narrower from behind, wider from the front."""
DEPTHS = np.linspace(-0.01, 0.055, 164)
"""(D,) sample positions across a side, in table lengths inwards from the outer edge of the cloth."""
POSITIONS = np.concatenate([np.linspace(0.09, 0.44, 70), np.linspace(0.56, 0.91, 70)])
"""(S,) sample positions along a side, away from corner and middle pockets."""
MIN_NOSE_GRADIENT = 0.6
"""Smallest gradient across a nose, CIE Lab units per px."""
FAINT_GRADIENT = 1.5
"""Gradient (Lab units per px) at which an edge may be a pixel off, as measured on recompressed and resized clips."""
SYSTEMATIC_SIGMA_PX = 0.4
"""px, systematic deviation of a sharp edge from the nose: shading, blur, chroma subsampling."""


@dataclass(frozen=True, slots=True)
class SideProfiles:
    """Colour profiles across one side of a table: S positions along it, D depths from its outer edge inwards."""

    pixels: FloatArray
    """(S, D, 2) px"""
    gradient: FloatArray
    """(S, D, 3) Lab units per px, inwards"""
    strength: FloatArray
    """(D,) norm of the median gradient along the side"""
    step: float
    """px from one depth to the next"""


@dataclass(frozen=True, slots=True)
class FittedLine:
    """A straight line in the image with its uncertainty."""

    coefficients: FloatArray
    """(3,) a x + b y + c = 0, unit normal"""
    centre: FloatArray
    """(2,) px, where offset and angle are uncorrelated"""
    offset_sigma: float
    """px"""
    angle_sigma: float
    """rad"""
    bend: float
    """px"""


def refine_outer_corners(image: ImageArray, outer: FloatArray) -> FloatArray:
    """Move outer corners onto the steepest line near each side; they come from a reduced image.

    Args:
        image: (H, W, 3) RGB.
        outer: (4, 2) px, outer corners of the cloth.

    Returns:
        Refined corners (4, 2) px, or the given ones where the lines are implausible.
    """
    reach = 1.6 * image.shape[1] / SEARCH_WIDTH_PX
    lines = []
    for k in range(4):
        px_per_length = sample_side_profiles(image, outer, k).step / (DEPTHS[1] - DEPTHS[0])
        side = sample_side_profiles(image, outer, k, np.linspace(-1, 1, 41) * reach / px_per_length)
        lines.append(_find_steepest_line(side))
    corners = intersect_lines(lines)
    if corners is None or np.linalg.norm(corners - outer, axis=1).max() > 6 * reach:
        return outer
    return corners


def _find_steepest_line(side: SideProfiles) -> FloatArray:
    """Find the line (3,) between any two depths with the largest median gradient across it."""
    count = side.gradient.shape[1]
    share = (POSITIONS - POSITIONS[0]) / (POSITIONS[-1] - POSITIONS[0])
    every = np.arange(0, len(POSITIONS), 4)
    candidates = np.arange(0, count, 2)
    best, ends = -1.0, (0, 0)
    for start in candidates:
        depth = np.rint(start + (candidates[:, None] - start) * share[every]).astype(int)  # (ends, positions)
        step = np.linalg.norm(np.median(side.gradient[every, depth], axis=1), axis=1)
        if step.max() > best:
            best, ends = float(step.max()), (int(start), int(candidates[int(np.argmax(step))]))
    depth = np.rint(ends[0] + (ends[1] - ends[0]) * share).astype(int)
    return line_through(side.pixels[0, depth[0]], side.pixels[-1, depth[-1]])


def sample_side_profiles(image: ImageArray, outer: FloatArray, side: int, depths: FloatArray = DEPTHS) -> SideProfiles:
    """Sample profiles across one side, smoothed by about a pixel.

    Args:
        image: (H, W, 3) RGB.
        outer: (4, 2) px, outer corners of the cloth.
        side: index of the side: top, right, bottom, left.
        depths: (D,) in table lengths inwards from the outer edge.

    Returns:
        The profiles and their gradients.
    """
    length, width = 1 + 2 * USUAL_CUSHION, 0.5 + 2 * USUAL_CUSHION
    along, inwards = np.meshgrid(POSITIONS, depths / (width if side % 2 == 0 else length), indexing="ij")
    u, v = ((along, inwards), (1 - inwards, along), (1 - along, 1 - inwards), (inwards, 1 - along))[side]
    pixels = apply_homography(homography_from_unit_square(outer), np.stack([u, v], axis=-1))
    step = float(np.median(np.linalg.norm(pixels[:, -1] - pixels[:, 0], axis=1)) / (len(depths) - 1))
    maps = pixels.astype(np.float32)
    lab = cv2.cvtColor(
        cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(
            np.float32
        )
        / 255,
        cv2.COLOR_RGB2LAB,
    )
    smooth = cv2.GaussianBlur(lab, (0, 0), sigmaX=max(0.8 / step, 0.5), sigmaY=0.01)
    gradient = np.gradient(smooth.astype(np.float64), axis=1) / step
    return SideProfiles(pixels, gradient, np.linalg.norm(np.median(gradient, axis=0), axis=1), step)


def find_side_lines(side: SideProfiles) -> tuple[FloatArray, FloatArray]:
    """Find depths and strengths of the lines along the whole side, within the range of cushion widths."""
    index, prominence = find_profile_peaks(side.strength, MIN_NOSE_GRADIENT, MIN_NOSE_GRADIENT / 2)
    depth = DEPTHS[index]
    sharp = prominence > 0.3 * side.strength[index]
    inside = (depth > CUSHION_RANGE[0]) & (depth < CUSHION_RANGE[1]) & sharp
    return depth[inside], side.strength[index][inside]


def find_profile_peaks(
    levels: FloatArray, least: float, least_prominence: float
) -> tuple[NDArray[np.intp], FloatArray]:
    """Find the maxima of a profile, as `scipy.signal.find_peaks` does.

    Args:
        levels: (D,) profile.
        least: smallest height.
        least_prominence: smallest prominence: the height above the higher of the two minima on the way to a higher
            level or the end.

    Returns:
        Indices (n,), the middle of a plateau; and prominences (n,).
    """
    bounds = np.concatenate([[0], 1 + np.flatnonzero(np.diff(levels)), [len(levels)]])  # runs of one level
    height = levels[bounds[:-1]]
    top = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] > height[2:]))
    top = top[height[top] >= least]
    prominence = np.array(
        [height[run] - max(_lowest_before_higher(height[run::-1]), _lowest_before_higher(height[run:])) for run in top]
    )
    enough = prominence >= least_prominence
    return ((bounds[top] + bounds[top + 1] - 1) // 2)[enough], prominence[enough]


def _lowest_before_higher(levels: FloatArray) -> float:
    """Return the minimum of levels (n,) before one is higher than the first."""
    higher = np.flatnonzero(levels > levels[0])
    return float(levels[: higher[0] if len(higher) else None].min())


def fit_side_line(side: SideProfiles, depth: float, cushion: float) -> FittedLine:
    """Fit a straight line robustly to sub-pixel edge positions along a side.

    Args:
        side: profiles of the side.
        depth: depth of the line, in table lengths.
        cushion: width of the cushion, in table lengths.

    Returns:
        The line; its uncertainty includes systematic deviations.
    """
    index = int(np.argmin(np.abs(DEPTHS - depth)))
    median = np.median(side.gradient[:, index], axis=0)
    along = side.gradient @ (median / np.linalg.norm(median))  # (S, D)
    half = int(max(0.25 * min(depth, cushion) / (DEPTHS[1] - DEPTHS[0]), 2.0 / side.step, 2))
    window = along[:, max(index - half, 1) : min(index + half + 1, along.shape[1] - 1)]  # a peak has neighbours
    peak = np.argmax(window, axis=1) + max(index - half, 1)
    rows = np.arange(len(along))
    before, top, after = along[rows, peak - 1], along[rows, peak], along[rows, peak + 1]
    bend = before - 2 * top + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1), 0.0)
    position = peak + np.clip(shift, -0.5, 0.5)
    is_clear = top > 0.4 * np.linalg.norm(median)
    floor = np.floor(position).astype(int)
    rest = (position - floor)[:, None]
    points = side.pixels[rows, floor] * (1 - rest) + side.pixels[rows, floor + 1] * rest
    fitted = fit_robust_line(points[is_clear] if is_clear.sum() > 20 else points)
    # A faint edge may be the end of a shadow instead of the nose.
    faint_sigma = FAINT_GRADIENT / float(np.linalg.norm(median))
    offset = float(np.hypot(fitted.offset_sigma, faint_sigma))
    angle = float(np.hypot(fitted.angle_sigma, faint_sigma / side_extent(side)))
    return replace(fitted, offset_sigma=offset, angle_sigma=angle)


def side_extent(side: SideProfiles) -> float:
    """Return the length of the sampled part of a side, px."""
    return float(np.linalg.norm(side.pixels[-1, 0] - side.pixels[0, 0]))


def fit_robust_line(points: FloatArray) -> FittedLine:
    """Fit a straight line to points (P, 2) by iteratively reweighted least squares with Tukey's weights."""
    weight = np.ones(len(points))
    residual = np.zeros(len(points))
    spread = 1.0
    centre, normal = points.mean(axis=0), np.array([0.0, 1.0])
    for _ in range(12):
        centre = weight @ points / weight.sum()
        centred = (points - centre) * np.sqrt(weight)[:, None]
        normal = np.linalg.svd(centred, full_matrices=False)[2][1]
        residual = (points - centre) @ normal
        spread = max(estimate_sigma(residual), 0.02)
        weight = np.clip(1 - (residual / (4.0 * spread)) ** 2, 0, None) ** 2 + 1e-9
    direction = np.array([-normal[1], normal[0]])
    along = (points - centre) @ direction
    # Neighbouring profiles share pixels and coding blocks: about one in six is independent.
    independent = max(weight.sum() / 6, 2.0)
    offset = float(np.hypot(spread / np.sqrt(independent), SYSTEMATIC_SIGMA_PX))
    length = float(np.sqrt(np.average(along**2, weights=weight)))
    angle = float(np.hypot(spread / np.sqrt(independent), 0.5 * SYSTEMATIC_SIGMA_PX) / max(length, 1.0))
    return FittedLine(
        np.array([normal[0], normal[1], -normal @ centre]),
        centre,
        offset,
        angle,
        _measure_bend(along, residual, weight),
    )


def _measure_bend(along: FloatArray, residual: FloatArray, weight: FloatArray) -> float:
    """Return the sagitta (px) of the parabola that fits the residuals."""
    curve = np.polyfit(along, residual, 2, w=np.sqrt(weight))
    return float(abs(curve[0]) * (0.5 * np.ptp(along)) ** 2)
