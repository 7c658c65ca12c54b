"""Selection of the cushion noses among the lines along the sides of a table."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import FloatArray, ImageArray
from video.calibration.camera_model import estimate_camera_position, fit_perspective, homography_between
from video.calibration.cloth_region import intersect_lines, line_through
from video.calibration.table_edges import (
    DEPTHS,
    USUAL_CUSHION,
    FittedLine,
    SideProfiles,
    find_side_lines,
    fit_robust_line,
    fit_side_line,
    refine_outer_corners,
    sample_side_profiles,
    side_extent,
)

CUSHION_SIGMA = 0.25
"""Standard deviation of the logarithm of a cushion's width relative to `USUAL_CUSHION`."""
EQUAL_SIGMA = 0.0018
"""Standard deviation of the width among the four cushions of one table, in table lengths."""
RISE = (0.0025, 0.0015)
"""Height of the cloth's outer edge above the nose in table lengths: mean and standard deviation."""
EDGE_SIGMA_PX = 0.7
"""px, standard deviation of the outer edge relative to the nose."""
HIDDEN_COST = 7.0
"""Cost of a nose that is not visible, in squared standard deviations."""
SKIPPED_COST = 4.0
"""Cost of skipping a line further out: shadows end inside the nose, never outside it."""
NEAR_SIGMAS = 3.0
"""Standard deviations of an expected nose within which a line is that nose."""
MAX_LINES_PER_SIDE = 4
"""Largest number of candidate lines per side."""


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
    outer = refine_outer_corners(image, outer)
    sides = [sample_side_profiles(image, outer, k) for k in range(4)]
    choice = _select_nose_lines(sides, outer, image.shape[1], image.shape[0])
    if sum(choice.is_visible) < 2:
        return None
    lines = [
        fit_side_line(side, depth, choice.cushion) if visible else _assume_line_at(side, depth, sigma)
        for side, depth, visible, sigma in zip(sides, choice.depths, choice.is_visible, choice.sigmas, strict=True)
    ]
    corners = intersect_lines([fitted.coefficients for fitted in lines])
    if corners is None:
        return None
    bend = max(fitted.bend for fitted, visible in zip(lines, choice.is_visible, strict=True) if visible)
    return CushionNoses(corners, _corner_covariance(lines), choice.cushion, choice.is_visible, choice.misfit, bend)


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
    nose_corners = intersect_lines([line.coefficients for line in lines])
    if sum(is_visible) < 2 or nose_corners is None:
        return None
    bend = max(line.bend for line in lines)
    return CushionNoses(nose_corners, _corner_covariance(lines), USUAL_CUSHION, tuple(is_visible), 0.0, bend)


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
    """Select the combination of lines, at most one per side, that equal cushions and a 2:1 table explain best."""
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


def _corner_covariance(lines: list[FittedLine]) -> FloatArray:
    """Propagate offsets and angles of the lines to the covariance (8, 8) px^2 of the four corners."""
    base = intersect_lines([line.coefficients for line in lines])
    assert base is not None
    columns = []
    for k, line in enumerate(lines):
        for kind, sigma in (("offset", line.offset_sigma), ("angle", line.angle_sigma)):
            perturbed = [other.coefficients for other in lines]
            perturbed[k] = _perturb_line(line, sigma if kind == "offset" else 0.0, sigma if kind == "angle" else 0.0)
            corners = intersect_lines(perturbed)
            columns.append(((corners if corners is not None else base) - base).ravel())
    jacobian = np.column_stack(columns)
    covariance: FloatArray = jacobian @ jacobian.T
    return covariance


def _perturb_line(fitted: FittedLine, offset: float, angle: float) -> FloatArray:
    """Shift a line by an offset (px) and rotate it by an angle (rad)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = fitted.coefficients[:2]
    normal = np.array([cosine * a - sine * b, sine * a + cosine * b])
    return np.array([normal[0], normal[1], -normal @ fitted.centre - offset])
