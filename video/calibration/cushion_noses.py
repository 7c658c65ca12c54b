"""Lines along the sides of a table, and the selection of the cushion noses among them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import FloatArray, ImageArray
from models.numerics.statistics import estimate_sigma
from video.calibration.camera_model import (
    estimate_camera_position,
    fit_perspective,
    homography_between,
    homography_from_unit_square,
)
from video.calibration.cloth_region import SEARCH_SIDE_PX, intersect_lines, line_through

# Standard deviation of the logarithm of a cushion's width relative to `USUAL_CUSHION`.
CUSHION_SIGMA = 0.25
# Standard deviation of the width among the four cushions of one table, in table lengths.
EQUAL_SIGMA = 0.0018
# Height of the cloth's outer edge above the nose in table lengths: mean and standard deviation.
RISE = (0.0025, 0.0015)
# px, standard deviation of the outer edge relative to the nose.
EDGE_SIGMA_PX = 0.7
# Cost of a nose that is not visible, in squared standard deviations.
HIDDEN_COST = 7.0
# Cost of skipping a line further out: shadows end inside the nose, never outside it.
SKIPPED_COST = 4.0
# Standard deviations of an expected nose within which a line is that nose.
NEAR_SIGMAS = 3.0
# px, longer side of the image in which lines are searched. A nose is a soft edge of some millimetres: a pixel or two of
# this size. In a photograph of 4032 px the seam, the weave and the shadow beside it are lines of their own.
PROFILE_SIDE_PX = 1920
# Largest number of candidate lines per side.
MAX_LINES_PER_SIDE = 4


@dataclass(frozen=True, slots=True)
class CushionNoses:
    """The nose rectangle in the image."""

    corners: FloatArray
    """(4, 2) px, in the order of the outer corners."""
    covariance: FloatArray
    """(8, 8) px^2."""
    cushion: float
    """Typical distance from the outer edge of the cloth to the nose, in table lengths."""
    is_visible: tuple[bool, ...]
    """Whether each side's nose is visible (top, right, bottom, left); else it is inferred from the other sides."""
    misfit: float
    """Deviation from equal cushions, a 2:1 table and lines along all sides, in squared standard deviations."""
    straightness: float
    """px, largest robust deviation of a nose from a straight line."""


@dataclass(frozen=True, slots=True)
class _NoseSelection:
    depths: FloatArray
    """(4,) depths of the noses, in table lengths inwards from the outer edge"""
    is_visible: tuple[bool, ...]
    cushion: float
    misfit: float
    sigmas: FloatArray
    """(4,) standard deviations of the depths where they are not visible"""


def find_cushion_noses(image: ImageArray, outer: FloatArray) -> CushionNoses | None:
    """Locate the four cushion noses inside the outer edge of the cloth.

    Args:
        image: (H, W, 3) RGB.
        outer: (4, 2) px, outer corners of the cloth; the first side is a long one.

    Returns:
        The nose rectangle; None where fewer than two noses are visible.
    """
    image, scale = _reduce_image(image)
    outer = refine_outer_corners(image, (outer + 0.5) * scale - 0.5)
    sides = [sample_side_profiles(image, outer, k) for k in range(4)]
    choice = _select_nose_lines(sides, outer, image.shape[1], image.shape[0])
    lines = [
        fit_side_line(side, depth, choice.cushion) if visible else _assume_line_at(side, depth, sigma)
        for side, depth, visible, sigma in zip(sides, choice.depths, choice.is_visible, choice.sigmas, strict=True)
    ]
    return _assemble_noses(lines, choice.is_visible, choice.cushion, choice.misfit, scale)


def _reduce_image(image: ImageArray) -> tuple[ImageArray, float]:
    """Return an image of at most `PROFILE_SIDE_PX`, and its scale."""
    height, width = image.shape[:2]
    scale = min(1.0, PROFILE_SIDE_PX / max(height, width))
    if scale == 1.0:
        return image, scale
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), scale


def _assemble_noses(
    lines: list[FittedLine], is_visible: tuple[bool, ...], cushion: float, misfit: float, scale: float
) -> CushionNoses | None:
    """Assemble noses from lines in an image reduced by `scale`; None where fewer than two are visible."""
    corners = intersect_lines([line.coefficients for line in lines])
    if sum(is_visible) < 2 or corners is None:
        return None
    bend = max(line.bend for line in lines)
    covariance = _corner_covariance(lines, corners) / scale**2
    return CushionNoses((corners + 0.5) / scale - 0.5, covariance, cushion, is_visible, misfit, bend / scale)


def find_noses_near(image: ImageArray, corners: FloatArray, covariance: FloatArray) -> CushionNoses | None:
    """Locate the four cushion noses near expected corners.

    A nose without a line within `NEAR_SIGMAS` standard deviations of its expected place is taken from there.

    Args:
        image: (H, W, 3) RGB.
        corners: (4, 2) px, expected corners; the first side is a long one.
        covariance: (8, 8) px^2.

    Returns:
        The nose rectangle; None where fewer than two noses are visible.
    """
    image, scale = _reduce_image(image)
    corners, covariance = (corners + 0.5) * scale - 0.5, covariance * scale**2
    plan = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5]])
    outwards = USUAL_CUSHION * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    outer = apply_homography(homography_between(plan, corners), plan + outwards)
    lines, is_visible = [], []
    for k in range(4):
        side, expected = sample_side_profiles(image, outer, k), _expect_line(corners, covariance, k)
        px_per_depth = side.step / (DEPTHS[1] - DEPTHS[0])
        reach = (NEAR_SIGMAS * expected.offset_sigma + side.step) / px_per_depth
        depth = find_side_lines(side)[0]
        near = depth[np.abs(depth - USUAL_CUSHION) < reach]
        is_visible.append(bool(len(near)))
        nearest = near[np.argmin(np.abs(near - USUAL_CUSHION))] if len(near) else 0.0
        lines.append(fit_side_line(side, float(nearest), USUAL_CUSHION) if len(near) else expected)
    return _assemble_noses(lines, tuple(is_visible), USUAL_CUSHION, 0.0, scale)


def _expect_line(corners: FloatArray, covariance: FloatArray, side: int) -> FittedLine:
    """Return the line through two expected corners with its uncertainty."""
    ends = (side, (side + 1) % 4)
    start, end = corners[ends[0]], corners[ends[1]]
    line = line_through(start, end)
    rows = [slice(2 * k, 2 * k + 2) for k in ends]
    normal = line[:2]
    (aa, ab), (ba, bb) = [[float(normal @ covariance[i, j] @ normal) for j in rows] for i in rows]
    length = float(np.linalg.norm(end - start))
    offset, angle = np.sqrt(max(aa + bb + ab + ba, 0.0)) / 2, np.sqrt(max(aa + bb - ab - ba, 0.0)) / length
    return FittedLine(line, (start + end) / 2, float(offset), float(angle), 0.0)


def _select_nose_lines(sides: list[SideProfiles], outer: FloatArray, width_px: int, height_px: int) -> _NoseSelection:
    """Select at most one line per side as its nose, so that cushions of equal width and a 2:1 table fit best."""
    candidates = [_list_candidates(side) for side in sides]
    parallax = _edge_parallax(outer, width_px, height_px)
    sigmas = np.array([np.hypot(EQUAL_SIGMA, EDGE_SIGMA_PX * (DEPTHS[1] - DEPTHS[0]) / side.step) for side in sides])
    scored = []
    for combination in product(*candidates):
        depths = np.array([depth for depth, _ in combination])
        width, rise, cost = _fit_cushion_width(depths, parallax, sigmas)
        scored.append((cost + sum(extra for _, extra in combination), width, rise, depths))
    scored.sort(key=lambda entry: entry[0])
    best: tuple[float, _NoseSelection] | None = None
    for cost, width, rise, depths in scored[:12]:
        is_visible = np.isfinite(depths)
        filled = np.where(is_visible, depths, np.clip(width + rise * parallax, 0.002, 0.05))
        total = cost + _shape_cost(sides, filled, is_visible, width_px, height_px)
        if best is None or total < best[0]:
            spread = np.hypot(sigmas, CUSHION_SIGMA * width / max(np.sqrt(is_visible.sum()), 1) / 2)
            best = (
                total,
                _NoseSelection(
                    filled, tuple(bool(s) for s in is_visible), width, total, np.asarray(spread, np.float64)
                ),
            )
    assert best is not None
    return best[1]


def _list_candidates(side: SideProfiles) -> list[tuple[float, float]]:
    """List (depth, cost) of each line along a side, and (NaN, cost) for an invisible nose."""
    depth, strength = find_side_lines(side)
    keep = np.sort(np.argsort(-strength)[:MAX_LINES_PER_SIDE])
    candidates: list[tuple[float, float]] = [(float("nan"), HIDDEN_COST)]
    strongest = strength.max(initial=0.0)
    for k in keep:
        skipped = np.any(strength[keep[keep < k]] > 0.35 * strongest)
        faint = -np.log(strength[k] / strongest)
        candidates.append((float(depth[k]), float(faint + SKIPPED_COST * skipped)))
    return candidates


def _edge_parallax(outer: FloatArray, width_px: int, height_px: int) -> FloatArray:
    """Apparent outward shift (4,) of the outer edge of each side per height above the noses."""
    length, width = 1 + 2 * USUAL_CUSHION, 0.5 + 2 * USUAL_CUSHION
    view = fit_perspective(outer, width_px, height_px, length / width, 2.0)
    plan = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    position = estimate_camera_position(homography_between(plan, outer), view.focal, width_px, height_px)
    outwards = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    middles = (plan + np.roll(plan, -1, axis=0)) / 2
    return np.asarray(np.sum(outwards * (middles - position[:2]), axis=1) / max(position[2], 0.1), np.float64)


def _fit_cushion_width(depths: FloatArray, parallax: FloatArray, sigmas: FloatArray) -> tuple[float, float, float]:
    """Fit cushion width and rise of its outer edge to the visible depths (4,); also return the squared misfit."""
    is_visible = np.isfinite(depths)
    rows = [np.column_stack([np.ones(int(is_visible.sum())), parallax[is_visible]]) / sigmas[is_visible, None]]
    rows.append(np.array([[1 / (CUSHION_SIGMA * USUAL_CUSHION), 0.0], [0.0, 1 / RISE[1]]]))
    right = np.concatenate([depths[is_visible] / sigmas[is_visible], [1 / CUSHION_SIGMA, RISE[0] / RISE[1]]])
    a = np.concatenate(rows)
    solution = np.linalg.solve(a.T @ a, a.T @ right)
    rise = float(max(solution[1], 0.0))
    error = a @ np.array([solution[0], rise]) - right
    return float(solution[0]), rise, float(error @ error)


def _shape_cost(
    sides: list[SideProfiles], depths: FloatArray, is_visible: NDArray[np.bool_], width_px: int, height_px: int
) -> float:
    """Squared standard deviations by which noses at these depths (4,) differ from a 2:1 rectangle in perspective."""
    segments = [side.pixels[:, _depth_index(depth)] for side, depth in zip(sides, depths, strict=True)]
    corners = intersect_lines([line_through(segment[0], segment[-1]) for segment in segments])
    if corners is None:
        return 1e6
    return fit_perspective(corners, width_px, height_px, 2.0, 1.0 if is_visible.all() else 2.0).misfit


def _depth_index(depth: float) -> int:
    """Return the index of the depth nearest to a value."""
    return int(np.argmin(np.abs(DEPTHS - depth)))


def _assume_line_at(side: SideProfiles, depth: float, depth_sigma: float) -> FittedLine:
    """Return the line at a depth for which the image shows no edge."""
    fitted = fit_robust_line(side.pixels[:, _depth_index(depth)])
    sigma = depth_sigma / (DEPTHS[1] - DEPTHS[0]) * side.step
    return FittedLine(fitted.coefficients, fitted.centre, sigma, 0.3 * sigma / side_extent(side), 0.0)


def _corner_covariance(lines: list[FittedLine], corners: FloatArray) -> FloatArray:
    """Propagate offsets and angles of the lines to the covariance (8, 8) px^2 of their corners (4, 2)."""
    columns = []
    for k, line in enumerate(lines):
        for offset, angle in ((line.offset_sigma, 0.0), (0.0, line.angle_sigma)):
            perturbed = [other.coefficients for other in lines]
            perturbed[k] = _perturb_line(line, offset, angle)
            moved = intersect_lines(perturbed)
            columns.append(((corners if moved is None else moved) - corners).ravel())
    jacobian = np.column_stack(columns)
    covariance: FloatArray = jacobian @ jacobian.T
    return covariance


def _perturb_line(fitted: FittedLine, offset: float, angle: float) -> FloatArray:
    """Shift a line by an offset (px) and rotate it by an angle (rad)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = fitted.coefficients[:2]
    normal = np.array([cosine * a - sine * b, sine * a + cosine * b])
    return np.array([normal[0], normal[1], -normal @ fitted.centre - offset])


# Width of a cushion's cloth in table lengths: about 50 mm on 2.54 m.
USUAL_CUSHION = 0.021
# Range of apparent cushion widths: narrower from behind, wider from the front.
CUSHION_RANGE = (0.003, 0.048)
# (D,) sample positions across a side, in table lengths inwards from the outer edge of the cloth.
DEPTHS = np.linspace(-0.01, 0.055, 164)
# (S,) sample positions along a side, away from corner and middle pockets.
POSITIONS = np.concatenate([np.linspace(0.09, 0.44, 70), np.linspace(0.56, 0.91, 70)])
# Smallest gradient across a nose, CIE Lab units per px.
MIN_NOSE_GRADIENT = 0.6
# Gradient (Lab units per px) at which an edge may be a pixel off, as measured on recompressed and resized clips.
FAINT_GRADIENT = 1.5
# px, systematic deviation of a sharp edge from the nose: shading, blur, chroma subsampling.
SYSTEMATIC_SIGMA_PX = 0.4


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
    reach = 1.6 * max(image.shape) / SEARCH_SIDE_PX
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
