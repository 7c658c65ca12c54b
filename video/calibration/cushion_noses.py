"""Which of the lines along the sides of a table are its cushion noses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.calibration.camera_model import best_view, eye_over, homography_between
from video.calibration.cloth_region import intersections, line_through
from video.calibration.table_edges import (
    DEPTHS,
    USUAL_CUSHION,
    Line,
    Side,
    extent,
    fit_line,
    robust_line,
    sample_side,
    sharpen_outer,
    side_peaks,
)

CUSHION_SIGMA = 0.25
"""Standard deviation of the logarithm of a cushion's width from `USUAL_CUSHION`."""
EQUAL_SIGMA = 0.0018
"""How much the four cushions of one table differ in width, in table lengths."""
RISE = (0.0025, 0.0015)
"""Height of the cloth's outer edge above the nose in table lengths: usual and standard deviation."""
EDGE_SIGMA = 0.7
"""px by which outer edge and nose may be misplaced against each other."""
HIDDEN_COST = 7.0
"""Squared standard deviations that it costs to say that a nose cannot be seen."""
SKIPPED_COST = 4.0
"""What it costs to pass over a line that lies further out: shadows end inside the nose, never outside it."""
MOST_LINES = 4
"""Lines per side that are considered."""


@dataclass(frozen=True, slots=True)
class Noses:
    """The nose rectangle in the picture."""

    corners: FloatArray
    """(4, 2) px, in the order of the outer corners."""
    covariance: FloatArray
    """(8, 8) px^2."""
    cushion: float
    """Usual distance from the outer edge of the cloth to the nose, in table lengths."""
    seen: tuple[bool, ...]
    """Whether a side's nose was seen (top, right, bottom, left); else it was put where the other sides say."""
    misfit: float
    """Squared standard deviations by which equal cushions, a 2:1 table and lines along all sides are missed."""
    straightness: float
    """px, the largest robust deviation of a nose from a straight line."""


@dataclass(frozen=True, slots=True)
class _Choice:
    depths: FloatArray
    """(4,) of the noses, in table lengths inwards from the outer edge"""
    seen: tuple[bool, ...]
    cushion: float
    misfit: float
    sigmas: FloatArray
    """(4,) of the depths, were they not seen"""


def find_noses(picture: ImageArray, outer: FloatArray) -> Noses | None:
    """Fit the four noses inside the outer corners (4, 2) of the cloth, the first side being a long one."""
    outer = sharpen_outer(picture, outer)
    sides = [sample_side(picture, outer, k) for k in range(4)]
    choice = _choose(sides, outer, picture.shape[1], picture.shape[0])
    if sum(choice.seen) < 2:
        return None
    lines = [
        fit_line(side, depth, choice.cushion) if is_seen else _assumed(side, depth, sigma)
        for side, depth, is_seen, sigma in zip(sides, choice.depths, choice.seen, choice.sigmas, strict=True)
    ]
    corners = intersections([fitted.line for fitted in lines])
    if corners is None:
        return None
    bend = max(fitted.bend for fitted, is_seen in zip(lines, choice.seen, strict=True) if is_seen)
    return Noses(corners, _covariance(lines), choice.cushion, choice.seen, choice.misfit, bend)


def _choose(sides: list[Side], outer: FloatArray, width_px: int, height_px: int) -> _Choice:
    """The combination of lines, one or none per side, that cushions of one width and a 2:1 table explain best."""
    candidates = [_candidates(side) for side in sides]
    lean = _lean(outer, width_px, height_px)
    sigmas = np.array([np.hypot(EQUAL_SIGMA, EDGE_SIGMA * (DEPTHS[1] - DEPTHS[0]) / side.step) for side in sides])
    rated = []
    for combination in product(*candidates):
        depths = np.array([depth for depth, _ in combination])
        width, rise, cost = _cushion_fit(depths, lean, sigmas)
        rated.append((cost + sum(extra for _, extra in combination), width, rise, depths))
    rated.sort(key=lambda one: one[0])
    best: tuple[float, _Choice] | None = None
    for cost, width, rise, depths in rated[:12]:
        seen = np.isfinite(depths)
        filled = np.where(seen, depths, np.clip(width + rise * lean, 0.002, 0.05))
        total = cost + _shape_cost(sides, filled, seen, width_px, height_px)
        if best is None or total < best[0]:
            spread = np.hypot(sigmas, CUSHION_SIGMA * width / max(np.sqrt(seen.sum()), 1) / 2)
            best = (total, _Choice(filled, tuple(bool(s) for s in seen), width, total, np.asarray(spread, np.float64)))
    assert best is not None
    return best[1]


def _candidates(side: Side) -> list[tuple[float, float]]:
    """(depth, cost) of each line along a side, and (NaN, cost) for a nose that is not seen."""
    depth, strength = side_peaks(side)
    keep = np.sort(np.argsort(-strength)[:MOST_LINES])
    found: list[tuple[float, float]] = [(float("nan"), HIDDEN_COST)]
    strongest = strength.max(initial=0.0)
    for k in keep:
        skipped = np.any(strength[keep[keep < k]] > 0.35 * strongest)
        faint = -np.log(strength[k] / strongest)
        found.append((float(depth[k]), float(faint + SKIPPED_COST * skipped)))
    return found


def _lean(outer: FloatArray, width_px: int, height_px: int) -> FloatArray:
    """How far (4,) the outer edge of each side seems to move outwards per height by which it lies above the noses."""
    length, width = 1 + 2 * USUAL_CUSHION, 0.5 + 2 * USUAL_CUSHION
    view = best_view(outer, width_px, height_px, length / width, 2.0)
    plan = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
    eye = eye_over(homography_between(plan, outer), view.focal, width_px, height_px)
    outwards = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    middles = (plan + np.roll(plan, -1, axis=0)) / 2
    return np.asarray(np.sum(outwards * (middles - eye[:2]), axis=1) / max(eye[2], 0.1), np.float64)


def _cushion_fit(depths: FloatArray, lean: FloatArray, sigmas: FloatArray) -> tuple[float, float, float]:
    """Cushion width and rise of its outer edge that explain the seen depths (4,), and the squared misfit."""
    seen = np.isfinite(depths)
    rows = [np.column_stack([np.ones(int(seen.sum())), lean[seen]]) / sigmas[seen, None]]
    rows.append(np.array([[1 / (CUSHION_SIGMA * USUAL_CUSHION), 0.0], [0.0, 1 / RISE[1]]]))
    right = np.concatenate([depths[seen] / sigmas[seen], [1 / CUSHION_SIGMA, RISE[0] / RISE[1]]])
    a = np.concatenate(rows)
    solution = np.linalg.solve(a.T @ a, a.T @ right)
    rise = float(max(solution[1], 0.0))
    miss = a @ np.array([solution[0], rise]) - right
    return float(solution[0]), rise, float(miss @ miss)


def _shape_cost(sides: list[Side], depths: FloatArray, seen: NDArray[np.bool_], width_px: int, height_px: int) -> float:
    """Squared standard deviations by which the noses at these depths (4,) are no 2:1 rectangle in perspective."""
    places = [side.pixels[:, _index(depth)] for side, depth in zip(sides, depths, strict=True)]
    corners = intersections([line_through(place[0], place[-1]) for place in places])
    if corners is None:
        return 1e6
    return best_view(corners, width_px, height_px, 2.0, 1.0 if seen.all() else 2.0).misfit


def _index(depth: float) -> int:
    return int(np.argmin(np.abs(DEPTHS - depth)))


def _assumed(side: Side, depth: float, depth_sigma: float) -> Line:
    """The line at a depth that nothing in the picture shows."""
    fitted = robust_line(side.pixels[:, _index(depth)])
    sigma = depth_sigma / (DEPTHS[1] - DEPTHS[0]) * side.step
    return Line(fitted.line, fitted.centre, sigma, 0.3 * sigma / extent(side), 0.0)


def _covariance(lines: list[Line]) -> FloatArray:
    """Covariance (8, 8) px^2 of the four corners from offsets and angles of the lines."""
    base = intersections([fitted.line for fitted in lines])
    assert base is not None
    columns = []
    for k, fitted in enumerate(lines):
        for kind, sigma in (("offset", fitted.offset_sigma), ("angle", fitted.angle_sigma)):
            moved = [other.line for other in lines]
            moved[k] = _moved(fitted, sigma if kind == "offset" else 0.0, sigma if kind == "angle" else 0.0)
            corners = intersections(moved)
            columns.append(((corners if corners is not None else base) - base).ravel())
    jacobian = np.column_stack(columns)
    covariance: FloatArray = jacobian @ jacobian.T
    return covariance


def _moved(fitted: Line, offset: float, angle: float) -> FloatArray:
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = fitted.line[:2]
    normal = np.array([cosine * a - sine * b, sine * a + cosine * b])
    return np.array([normal[0], normal[1], -normal @ fitted.centre - offset])
