"""The cushion noses: from the outer edge of the cloth inwards, the first line where the cushion's top ends."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from models.scene import apply_homography
from video.table_camera import square_to_quad
from video.table_cloth import intersections

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

USUAL_CUSHION = 0.021
"""Width of a cushion's cloth in table lengths: about 50 mm on 2.54 m."""
CUSHION_RANGE = (0.009, 0.036)
"""Narrowest and widest accepted: cushions seen from behind look narrower, from the front wider."""
DEPTHS = np.linspace(-0.01, 0.055, 164)
"""(D,) places across a side, in table lengths inwards from the outer edge of the cloth."""
POSITIONS = np.concatenate([np.linspace(0.09, 0.44, 70), np.linspace(0.56, 0.91, 70)])
"""(S,) places along a side, away from corner and middle pockets."""
LEAST_STEP = 0.35
"""Least change across a nose in CIE Lab units per px."""
SYSTEMATIC = 0.4
"""px by which a sharp edge in the picture may differ from the nose: shading, blur, chroma subsampling."""


@dataclass(frozen=True, slots=True)
class Noses:
    """The nose rectangle in the picture."""

    corners: Floats
    """(4, 2) px, in the order of the outer corners."""
    covariance: Floats
    """(8, 8) px^2."""
    cushion: float
    """Usual distance from the outer edge of the cloth to the nose, in table lengths."""
    seen: tuple[bool, bool, bool, bool]
    """Whether a side's nose was seen (top, right, bottom, left); else it was put where the other sides say."""
    straightness: float
    """px, the largest robust deviation of a nose from a straight line."""


@dataclass(frozen=True, slots=True)
class _Side:
    pixels: Floats
    """(S, D, 2) px"""
    gradient: Floats
    """(S, D, 3) Lab units per px, inwards"""
    strength: Floats
    """(D,) of the median gradient along the side"""
    step: float
    """px from one depth to the next"""


@dataclass(frozen=True, slots=True)
class _Line:
    line: Floats
    """(3,) a x + b y + c = 0, unit normal"""
    centre: Floats
    """(2,) px, where offset and angle are uncorrelated"""
    offset_sigma: float
    """px"""
    angle_sigma: float
    """rad"""
    bend: float
    """px"""


def find_noses(picture: Picture, outer: Floats, pockets: bool = True) -> Noses | None:
    """Fit the four noses inside the outer corners (4, 2) of the cloth, the first side being a long one."""
    sides = [_sample(picture, outer, k) for k in range(4)]
    peaks = [_peaks(side) for side in sides]
    cushion = _consensus(peaks)
    if cushion is None:
        return None
    depths, seen = _choose(peaks, cushion)
    lines = [
        _fit_nose(side, depth, cushion) if is_seen else _assumed(side, depth, cushion)
        for side, depth, is_seen in zip(sides, depths, seen, strict=True)
    ]
    corners = intersections([fitted.line for fitted in lines])
    if corners is None:
        return None
    bend = max((fitted.bend for fitted, is_seen in zip(lines, seen, strict=True) if is_seen), default=0.0)
    return Noses(corners, _covariance(lines), cushion, (seen[0], seen[1], seen[2], seen[3]), bend)


def _sample(picture: Picture, outer: Floats, side: int) -> _Side:
    """Profiles across one side, smoothed by about a pixel."""
    length, width = 1 + 2 * USUAL_CUSHION, 0.5 + 2 * USUAL_CUSHION
    along, inwards = np.meshgrid(POSITIONS, DEPTHS / (width if side % 2 == 0 else length), indexing="ij")
    u, v = ((along, inwards), (1 - inwards, along), (1 - along, 1 - inwards), (inwards, 1 - along))[side]
    pixels = apply_homography(square_to_quad(outer), np.stack([u, v], axis=-1))
    step = float(np.median(np.linalg.norm(pixels[:, -1] - pixels[:, 0], axis=1)) / (len(DEPTHS) - 1))
    maps = pixels.astype(np.float32)
    lab = cv2.cvtColor(
        cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(
            np.float32
        )
        / 255,
        cv2.COLOR_RGB2LAB,
    )
    smooth = cv2.GaussianBlur(lab, (0, 0), sigmaX=max(0.8 / step, 0.5), sigmaY=0.01)
    gradient = np.gradient(smooth.astype(np.float64), axis=1) / step
    return _Side(pixels, gradient, np.linalg.norm(np.median(gradient, axis=0), axis=1), step)


def _peaks(side: _Side) -> tuple[Floats, Floats]:
    """Depths and strengths of lines that run along the whole side, in the range of cushion widths."""
    index, properties = find_peaks(side.strength, height=LEAST_STEP, prominence=LEAST_STEP / 2)
    depth = DEPTHS[index]
    sharp = properties["prominences"] > 0.3 * properties["peak_heights"]
    inside = (depth > CUSHION_RANGE[0]) & (depth < CUSHION_RANGE[1]) & sharp
    return depth[inside], side.strength[index][inside]


def _consensus(peaks: list[tuple[Floats, Floats]]) -> float | None:
    """The cushion width on which most sides agree: the first line inwards, if it is not much weaker than the next."""
    first = []
    for depth, strength in peaks:
        if len(depth):
            first.append(float(depth[strength > 0.35 * strength.max()][0]))
    if len(first) < 2:
        return None
    widths = np.array(first)
    votes = [np.sum(np.abs(widths - w) < 0.2 * w) - abs(np.log(w / USUAL_CUSHION)) for w in widths]
    chosen = widths[int(np.argmax(votes))]
    return float(np.median(widths[np.abs(widths - chosen) < 0.2 * chosen]))


def _choose(peaks: list[tuple[Floats, Floats]], cushion: float) -> tuple[list[float], list[bool]]:
    """Depth of the nose on each side, and whether it was seen there."""
    depths: list[float] = []
    seen: list[bool] = []
    for depth, strength in peaks:
        if len(depth):
            # The first line inwards is the nose; what follows is the end of its shadow or of the cushion's face.
            fit = strength * np.exp(-0.5 * (np.log(depth / cushion) / 0.35) ** 2)
            best = int(np.argmax(fit > 0.35 * fit.max()))
        if len(depth) and 0.4 * cushion < depth[best] < 1.8 * cushion:
            depths.append(float(depth[best]))
            seen.append(True)
        else:
            depths.append(np.nan)
            seen.append(False)
    return _fill(depths, cushion), seen


def _fill(depths: list[float], cushion: float) -> list[float]:
    """A side that hides its nose looks as much narrower as the opposite side looks wider.

    The outer edge lies a little above the nose, so a slanting view moves one towards the other.
    """
    filled = []
    for k, depth in enumerate(depths):
        opposite = depths[(k + 2) % 4]
        if np.isnan(depth):
            depth = cushion if np.isnan(opposite) else cushion * np.clip(2 - opposite / cushion, 0.5, 1.3)
        filled.append(float(depth))
    return filled


def _fit_nose(side: _Side, depth: float, cushion: float) -> _Line:
    """Sub-pixel places of the line at many positions along the side, and a robust straight line through them."""
    at = int(np.argmin(np.abs(DEPTHS - depth)))
    median = np.median(side.gradient[:, at], axis=0)
    along = side.gradient @ (median / np.linalg.norm(median))  # (S, D)
    half = int(max(0.25 * min(depth, cushion) / (DEPTHS[1] - DEPTHS[0]), 2.0 / side.step, 2))
    window = along[:, max(at - half, 1) : at + half + 1]
    peak = np.argmax(window, axis=1) + max(at - half, 1)
    rows = np.arange(len(along))
    before, top, after = along[rows, peak - 1], along[rows, peak], along[rows, peak + 1]
    bend = before - 2 * top + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1), 0.0)
    place = peak + np.clip(shift, -0.5, 0.5)
    good = top > 0.4 * np.linalg.norm(median)
    floor = np.floor(place).astype(int)
    rest = (place - floor)[:, None]
    points = side.pixels[rows, floor] * (1 - rest) + side.pixels[rows, floor + 1] * rest
    return _robust_line(points[good] if good.sum() > 20 else points)


def _assumed(side: _Side, depth: float, cushion: float) -> _Line:
    """The line at a depth that nothing in the picture shows, as uncertain as cushions differ."""
    at = int(np.argmin(np.abs(DEPTHS - depth)))
    fitted = _robust_line(side.pixels[:, at])
    sigma = 0.25 * cushion / (DEPTHS[1] - DEPTHS[0]) * side.step
    return _Line(fitted.line, fitted.centre, sigma, 0.3 * sigma / _extent(side), 0.0)


def _extent(side: _Side) -> float:
    return float(np.linalg.norm(side.pixels[-1, 0] - side.pixels[0, 0]))


def _robust_line(points: Floats) -> _Line:
    """Straight line through points (P, 2) by iteratively reweighted least squares with Tukey's weights."""
    weight = np.ones(len(points))
    residual = np.zeros(len(points))
    spread = 1.0
    centre, normal = points.mean(axis=0), np.array([0.0, 1.0])
    for _ in range(12):
        centre = weight @ points / weight.sum()
        centred = (points - centre) * np.sqrt(weight)[:, None]
        normal = np.linalg.svd(centred, full_matrices=False)[2][1]
        residual = (points - centre) @ normal
        spread = max(1.4826 * float(np.median(np.abs(residual - np.median(residual)))), 0.02)
        weight = np.clip(1 - (residual / (4.0 * spread)) ** 2, 0, None) ** 2 + 1e-9
    direction = np.array([-normal[1], normal[0]])
    along = (points - centre) @ direction
    # Neighbouring profiles share pixels and coding blocks: about one in six is independent.
    independent = max(weight.sum() / 6, 2.0)
    offset = float(np.hypot(spread / np.sqrt(independent), SYSTEMATIC))
    length = float(np.sqrt(np.average(along**2, weights=weight)))
    angle = float(np.hypot(spread / np.sqrt(independent), 0.5 * SYSTEMATIC) / max(length, 1.0))
    return _Line(
        np.array([normal[0], normal[1], -normal @ centre]), centre, offset, angle, _bend(along, residual, weight)
    )


def _bend(along: Floats, residual: Floats, weight: Floats) -> float:
    """Sagitta in px of the parabola that fits the residuals."""
    curve = np.polyfit(along, residual, 2, w=np.sqrt(weight))
    return float(abs(curve[0]) * (0.5 * np.ptp(along)) ** 2)


def _covariance(lines: list[_Line]) -> Floats:
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
    covariance: Floats = jacobian @ jacobian.T
    return covariance


def _moved(fitted: _Line, offset: float, angle: float) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = fitted.line[:2]
    normal = np.array([cosine * a - sine * b, sine * a + cosine * b])
    return np.array([normal[0], normal[1], -normal @ fitted.centre - offset])
