"""Lines along the sides of a table: profiles across a side, the steps in them, sub-pixel straight lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import FloatArray, ImageArray
from video.calibration.camera_model import square_to_quad
from video.calibration.cloth_region import SEARCH_WIDTH, intersections, line_through

USUAL_CUSHION = 0.021
"""Width of a cushion's cloth in table lengths: about 50 mm on 2.54 m."""
CUSHION_RANGE = (0.003, 0.048)
"""Narrowest and widest looked at: cushions seen from behind look narrower, from the front wider."""
DEPTHS = np.linspace(-0.01, 0.055, 164)
"""(D,) places across a side, in table lengths inwards from the outer edge of the cloth."""
POSITIONS = np.concatenate([np.linspace(0.09, 0.44, 70), np.linspace(0.56, 0.91, 70)])
"""(S,) places along a side, away from corner and middle pockets."""
LEAST_STEP = 0.6
"""Least change across a nose in CIE Lab units per px."""
FAINT = 1.5
"""A step of so many Lab units per px may lie a pixel off: recompressing and resizing clips moved faint lines so."""
SYSTEMATIC = 0.4
"""px by which a sharp edge in the picture may differ from the nose: shading, blur, chroma subsampling."""


@dataclass(frozen=True, slots=True)
class Side:
    """Profiles across one side of a table, S places along it, D depths from its outer edge inwards."""

    pixels: FloatArray
    """(S, D, 2) px"""
    gradient: FloatArray
    """(S, D, 3) Lab units per px, inwards"""
    strength: FloatArray
    """(D,) of the median gradient along the side"""
    step: float
    """px from one depth to the next"""


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line in the picture and how well it is known."""

    line: FloatArray
    """(3,) a x + b y + c = 0, unit normal"""
    centre: FloatArray
    """(2,) px, where offset and angle are uncorrelated"""
    offset_sigma: float
    """px"""
    angle_sigma: float
    """rad"""
    bend: float
    """px"""


def sharpen_outer(picture: ImageArray, outer: FloatArray) -> FloatArray:
    """Outer corners (4, 2) moved onto the steepest line near each side; they come from a reduced picture."""
    reach = 1.6 * picture.shape[1] / SEARCH_WIDTH
    lines = []
    for k in range(4):
        px_per_length = sample_side(picture, outer, k).step / (DEPTHS[1] - DEPTHS[0])
        side = sample_side(picture, outer, k, np.linspace(-1, 1, 41) * reach / px_per_length)
        lines.append(_steepest_line(side))
    corners = intersections(lines)
    if corners is None or np.linalg.norm(corners - outer, axis=1).max() > 6 * reach:
        return outer
    return corners


def _steepest_line(side: Side) -> FloatArray:
    """The line (3,) that starts and ends at any two depths and has the largest median step across it."""
    count = side.gradient.shape[1]
    share = (POSITIONS - POSITIONS[0]) / (POSITIONS[-1] - POSITIONS[0])
    every = np.arange(0, len(POSITIONS), 4)
    places = np.arange(0, count, 2)
    best, ends = -1.0, (0, 0)
    for start in places:
        depth = np.rint(start + (places[:, None] - start) * share[every]).astype(int)  # (ends, positions)
        step = np.linalg.norm(np.median(side.gradient[every, depth], axis=1), axis=1)
        if step.max() > best:
            best, ends = float(step.max()), (int(start), int(places[int(np.argmax(step))]))
    depth = np.rint(ends[0] + (ends[1] - ends[0]) * share).astype(int)
    return line_through(side.pixels[0, depth[0]], side.pixels[-1, depth[-1]])


def sample_side(picture: ImageArray, outer: FloatArray, side: int, depths: FloatArray = DEPTHS) -> Side:
    """Profiles across one side, at depths (D,) in table lengths, smoothed by about a pixel."""
    length, width = 1 + 2 * USUAL_CUSHION, 0.5 + 2 * USUAL_CUSHION
    along, inwards = np.meshgrid(POSITIONS, depths / (width if side % 2 == 0 else length), indexing="ij")
    u, v = ((along, inwards), (1 - inwards, along), (1 - along, 1 - inwards), (inwards, 1 - along))[side]
    pixels = apply_homography(square_to_quad(outer), np.stack([u, v], axis=-1))
    step = float(np.median(np.linalg.norm(pixels[:, -1] - pixels[:, 0], axis=1)) / (len(depths) - 1))
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
    return Side(pixels, gradient, np.linalg.norm(np.median(gradient, axis=0), axis=1), step)


def side_peaks(side: Side) -> tuple[FloatArray, FloatArray]:
    """Depths and strengths of lines that run along the whole side, in the range of cushion widths."""
    index, prominence = peaks(side.strength, LEAST_STEP, LEAST_STEP / 2)
    depth = DEPTHS[index]
    sharp = prominence > 0.3 * side.strength[index]
    inside = (depth > CUSHION_RANGE[0]) & (depth < CUSHION_RANGE[1]) & sharp
    return depth[inside], side.strength[index][inside]


def peaks(levels: FloatArray, least: float, least_prominence: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Indices (n,) of the maxima inside levels (D,) that are high enough, a plateau's its middle; their prominences.

    The prominence is the height over the higher of the two lowest levels on the way to something higher, or to the end.
    """
    bounds = np.concatenate([[0], 1 + np.flatnonzero(np.diff(levels)), [len(levels)]])  # runs of one level
    height = levels[bounds[:-1]]
    top = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] > height[2:]))
    top = top[height[top] >= least]
    prominence = np.array([height[run] - max(_lowest(height[run::-1]), _lowest(height[run:])) for run in top])
    enough = prominence >= least_prominence
    return ((bounds[top] + bounds[top + 1] - 1) // 2)[enough], prominence[enough]


def _lowest(levels: FloatArray) -> float:
    """The least of levels (n,) before one is higher than the first."""
    higher = np.flatnonzero(levels > levels[0])
    return float(levels[: higher[0] if len(higher) else None].min())


def fit_line(side: Side, depth: float, cushion: float) -> Line:
    """Sub-pixel places of the line at many positions along the side, and a robust straight line through them."""
    at = int(np.argmin(np.abs(DEPTHS - depth)))
    median = np.median(side.gradient[:, at], axis=0)
    along = side.gradient @ (median / np.linalg.norm(median))  # (S, D)
    half = int(max(0.25 * min(depth, cushion) / (DEPTHS[1] - DEPTHS[0]), 2.0 / side.step, 2))
    window = along[:, max(at - half, 1) : min(at + half + 1, along.shape[1] - 1)]  # a peak has neighbours
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
    fitted = robust_line(points[good] if good.sum() > 20 else points)
    # A faint step is easily the end of a shadow instead of the nose itself.
    doubt = FAINT / float(np.linalg.norm(median))
    offset = float(np.hypot(fitted.offset_sigma, doubt))
    angle = float(np.hypot(fitted.angle_sigma, doubt / extent(side)))
    return replace(fitted, offset_sigma=offset, angle_sigma=angle)


def extent(side: Side) -> float:
    return float(np.linalg.norm(side.pixels[-1, 0] - side.pixels[0, 0]))


def robust_line(points: FloatArray) -> Line:
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
    return Line(
        np.array([normal[0], normal[1], -normal @ centre]), centre, offset, angle, _bend(along, residual, weight)
    )


def _bend(along: FloatArray, residual: FloatArray, weight: FloatArray) -> float:
    """Sagitta in px of the parabola that fits the residuals."""
    curve = np.polyfit(along, residual, 2, w=np.sqrt(weight))
    return float(abs(curve[0]) * (0.5 * np.ptp(along)) ** 2)
