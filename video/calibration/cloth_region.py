"""Detection of the cloth: the region of one colour that has the shape of a table, cushions included."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray

# Longer side in px of the reduced image in which the cloth is searched: a turned image gives the turned table.
SEARCH_SIDE_PX = 480
# Smallest share of the image that a table must cover to be measured.
MIN_TABLE_SHARE = 0.06
# Longer side in px of the reduced image from which the local cloth colour is taken: balls cover a few px there.
ILLUMINATION_SIDE_PX = 160
# Smallest share of the quadrangle that must have the cloth's colour; players, shadows and balls cover the rest.
MIN_FILL_SHARE = 0.5
# Candidate thresholds (rad) of the angle between colour vectors within which a pixel has the hue of the cloth.
MAX_HUE_ANGLES = (0.07, 0.12, 0.2)
# Distance from the outline of a region, in its length, up to which a polygon replaces it.
POLYGON_TOLERANCE = 0.006
# Candidate thresholds of the brightness relative to the cloth; cushions are shaded.
MIN_BRIGHTNESSES = (0.35, 0.5, 0.65)


@dataclass(frozen=True, slots=True)
class ClothRegion:
    """The cloth as a quadrangle along its outer edge, where the wood of the rails begins."""

    corners: FloatArray
    """(4, 2) px, clockwise in the image."""
    colour: FloatArray
    """(3,) RGB, 0 to 255."""
    support: float
    """Share of the quadrangle's sides along which the region really ends, 0 to 1."""


@dataclass(frozen=True, slots=True)
class _Quadrangle:
    corners: FloatArray
    support: float


def find_cloth_regions(image: ImageArray, count: int = 3, is_cropped: bool = False) -> list[ClothRegion]:
    """Find the regions of one colour that resemble a table most.

    Args:
        image: (H, W, 3) RGB.
        count: largest number of regions.
        is_cropped: whether the border of the image counts as the end of a cloth that reaches it.

    Returns:
        Clearly different regions, the best first.
    """
    scale = max(image.shape) / SEARCH_SIDE_PX
    size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    quadrangles = [
        quadrangle
        for colour in find_dominant_colours(small)
        for mask in _colour_masks(small, colour)
        if (quadrangle := _fit_quadrangle(mask, is_cropped)) is not None
    ]
    best = max((quadrangle.support for quadrangle in quadrangles), default=0.0)
    # Regions without the cushions have equally sharp borders: among equals the largest is the table.
    quadrangles.sort(
        key=lambda quadrangle: (
            quadrangle.support >= 0.95 * best,
            _polygon_area(quadrangle.corners) * quadrangle.support,
        ),
        reverse=True,
    )
    different: list[_Quadrangle] = []
    for quadrangle in quadrangles:
        if all(_max_corner_distance(quadrangle.corners, other.corners) > 4.0 for other in different):
            different.append(quadrangle)
    return [
        ClothRegion(
            (quadrangle.corners + 0.5) * scale - 0.5,
            measure_median_colour(small, quadrangle.corners),
            quadrangle.support,
        )
        for quadrangle in different[:count]
    ]


def _max_corner_distance(corners: FloatArray, others: FloatArray) -> float:
    """Return the largest distance (px) from a corner to the nearest corner of the other quadrangle."""
    return float(np.linalg.norm(corners[:, None] - others[None], axis=2).min(axis=1).max())


def find_dominant_colours(image: ImageArray, count: int = 5) -> list[FloatArray]:
    """Find the most frequent colours that are not nearly black.

    Args:
        image: (H, W, 3) RGB.
        count: largest number of colours.

    Returns:
        Median colours, each (3,) RGB.
    """
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).reshape(-1, 3)
    keys = (lab[:, 0] >> 5).astype(np.int64) * 1024 + (lab[:, 1] >> 3).astype(np.int64) * 32 + (lab[:, 2] >> 3)
    votes = np.bincount(keys, minlength=8 * 1024).reshape(8, 32, 32).astype(np.float32)
    smooth = votes.copy()
    for axis in range(3):
        smooth += 0.5 * (np.roll(smooth, 1, axis) + np.roll(smooth, -1, axis))
    smooth[:2] = 0  # L* below 25: dark surroundings, not a lit cloth
    colours: list[FloatArray] = []
    pixels = image.reshape(-1, 3)
    for _ in range(count):
        light, a, b = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
        near = (
            (np.abs((lab[:, 0] >> 5).astype(int) - light) <= 1)
            & (np.abs((lab[:, 1] >> 3).astype(int) - a) <= 1)
            & (np.abs((lab[:, 2] >> 3).astype(int) - b) <= 1)
        )
        if near.mean() >= MIN_TABLE_SHARE / 3:
            colours.append(np.median(pixels[near], axis=0).astype(np.float64))
        smooth[max(light - 1, 0) : light + 2, max(a - 2, 0) : a + 3, max(b - 2, 0) : b + 3] = 0
    return colours


def compare_with_cloth(image: ImageArray, colour: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compare the colour of every pixel with the cloth.

    Args:
        image: (H, W, 3) RGB.
        colour: colour of the cloth, (3,) RGB, or (H, W, 3) under uneven light.

    Returns:
        (H, W) angle (rad) between the colour vectors, and (H, W) brightness relative to the cloth.
    """
    rgb, cloth = (levels.astype(np.float32).reshape(-1, 3) for levels in (image, colour))
    length = np.sqrt(np.einsum("nc,nc->n", rgb, rgb))
    usual = np.maximum(np.sqrt(np.einsum("nc,nc->n", cloth, cloth)), 1)
    along = (rgb @ cloth[0] if len(cloth) == 1 else np.einsum("nc,nc->n", rgb, cloth)) / usual
    angle = np.arccos(np.clip(along / np.maximum(length, 1e-3), -1, 1)).astype(np.float32)
    return angle.reshape(image.shape[:2]), (length / usual).astype(np.float32).reshape(image.shape[:2])


def estimate_local_cloth_colour(image: ImageArray, width: int, height: int) -> FloatArray:
    """Estimate the colour of the cloth around every position under uneven light.

    Args:
        image: (H, W, 3) RGB.
        width: width of the result, px.
        height: height of the result, px.

    Returns:
        (height, width, 3) RGB, without objects of a ball's size.
    """
    scale = ILLUMINATION_SIDE_PX / max(width, height)
    thumbnail = cv2.resize(image, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
    smooth = cv2.medianBlur(thumbnail, 13)
    large = cv2.resize(smooth.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large, np.float64)


def measure_median_colour(image: ImageArray, corners: FloatArray) -> FloatArray:
    """Measure the median colour (3,) of an image (H, W, 3) inside corners (4, 2) px."""
    inside = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    return np.asarray(np.median(image[inside > 0], axis=0), np.float64)


def _colour_masks(small: ImageArray, colour: FloatArray) -> list[NDArray[np.uint8]]:
    angle, shade = compare_with_cloth(cv2.GaussianBlur(small, (0, 0), 0.7), colour)
    return [
        ((angle < a) & (shade > s) & (shade < 1.7)).astype(np.uint8) for a in MAX_HUE_ANGLES for s in MIN_BRIGHTNESSES
    ]


def _fit_quadrangle(mask: NDArray[np.uint8], is_cropped: bool) -> _Quadrangle | None:
    """Fit a quadrangle to the four long sides of the hull of the largest region; None where it does not fit."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    region = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel), cv2.MORPH_OPEN, kernel)
    contours, _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=cv2.contourArea)
    if cv2.contourArea(contour) < MIN_TABLE_SHARE * mask.size:
        return None
    hull = cv2.convexHull(contour)
    length = cv2.arcLength(hull, True)
    polygon = cv2.approxPolyDP(hull, POLYGON_TOLERANCE * length, True)[:, 0].astype(np.float64)
    # the polygon lies inside the outline, from which all its sides may be as far as the tolerance
    corners = _select_sides(polygon, float(cv2.contourArea(hull)), POLYGON_TOLERANCE * length**2)
    if corners is None:
        return None
    corners = _refine_sides(corners, contour[:, 0].astype(np.float64))
    if corners is None or cv2.contourArea(contour) < MIN_FILL_SHARE * _polygon_area(corners):
        return None
    if _fill_share(mask, corners) < MIN_FILL_SHARE:
        return None  # a wooden frame, not the cloth inside it
    return _Quadrangle(corners, _side_support(corners, contour, mask.shape, is_cropped))


def _fill_share(mask: NDArray[np.uint8], corners: FloatArray) -> float:
    """Return the share of the quadrangle (4, 2) that has the colour."""
    inside = np.zeros_like(mask)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    return float(mask[inside > 0].mean()) if inside.any() else 0.0


def _select_sides(polygon: FloatArray, area: float, slack: float) -> FloatArray | None:
    """Select the four sides of a convex polygon (K, 2) whose lines enclose it most tightly; return corners (4, 2).

    They enclose the `area` (px^2) of what the polygon replaces, which may be larger by `slack`.
    """
    count = len(polygon)
    if count < 4:
        return None
    if _shoelace_area(polygon) < 0:
        polygon = polygon[::-1]
    lines = [line_through(polygon[i], polygon[(i + 1) % count]) for i in range(count)]
    lengths = np.array([np.linalg.norm(polygon[(i + 1) % count] - polygon[i]) for i in range(count)])
    best, best_score = None, -np.inf
    longest = sorted(np.argsort(-lengths)[:9])
    for chosen in combinations(longest, 4):
        corners = intersect_lines([lines[i] for i in chosen])
        if corners is None or not _is_convex(corners):
            continue
        size = _polygon_area(corners)
        if not area - slack < size < 1.6 * area:
            continue
        score = lengths[list(chosen)].sum() / lengths.sum() - 1.5 * (size / area - 1)
        if score > best_score:
            best, best_score = corners, score
    return best


def _refine_sides(corners: FloatArray, contour: FloatArray) -> FloatArray | None:
    """Fit each side to the contour points (P, 2) along it (least squares with a narrowing distance limit)."""
    for max_distance in (6.0, 3.0, 1.5):
        lines = []
        for i in range(4):
            p, q = corners[i], corners[(i + 1) % 4]
            line = line_through(p, q)
            along = (contour - p) @ (q - p) / ((q - p) @ (q - p))
            is_near = (np.abs(contour @ line[:2] + line[2]) < max_distance) & (along > 0.06) & (along < 0.94)
            lines.append(_fit_line_to_points(contour[is_near]) if is_near.sum() >= 10 else line)
        snapped = intersect_lines(lines)
        if snapped is None or not _is_convex(snapped):
            return None
        corners = snapped
    return corners


def _side_support(corners: FloatArray, contour: NDArray[np.int32], shape: tuple[int, ...], is_cropped: bool) -> float:
    """Return the share of the sides (without ends) with a contour point within 2.5 px; bad sides count twice.

    At the border of the image every region ends, so that points there count only where `is_cropped` says so.
    """
    outline = np.ones(shape, np.uint8)
    outline[contour[:, 0, 1], contour[:, 0, 0]] = 0
    distance = cv2.distanceTransform(outline, cv2.DIST_L2, 3)
    shares = []
    for i in range(4):
        p, q = corners[i], corners[(i + 1) % 4]
        points = np.rint(p + np.linspace(0.1, 0.9, 60)[:, None] * (q - p)).astype(int)
        inside = is_cropped | np.all((points > 2) & (points < np.array([shape[1], shape[0]]) - 3), axis=1)
        column, row = np.clip(points[:, 0], 0, shape[1] - 1), np.clip(points[:, 1], 0, shape[0] - 1)
        shares.append(float(np.mean((distance[row, column] < 2.5) & inside)))
    return float(np.mean(shares) * min(1.0, min(shares) / 0.5))


def line_through(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the line (a, b, c) through two points: a x + b y + c = 0 with unit normal."""
    direction = (q - p) / np.linalg.norm(q - p)
    normal = np.array([-direction[1], direction[0]])
    return np.array([normal[0], normal[1], -normal @ p])


def _fit_line_to_points(points: FloatArray) -> FloatArray:
    """Fit a line (3,) to points (P, 2) by total least squares."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][1]
    return np.array([normal[0], normal[1], -normal @ centre])


def intersect_lines(lines: list[FloatArray]) -> FloatArray | None:
    """Intersect four lines in cyclic order: corner i of (4, 2) lies on lines i - 1 and i; None if two are parallel."""
    corners = []
    rows = [
        line.tolist() for line in lines
    ]  # Python floats are faster than arrays here: hundreds of combinations are evaluated
    for i in range(4):
        (a, b, c), (d, e, f) = rows[i - 1], rows[i]
        across = a * e - b * d
        if abs(across) < 1e-6:
            return None
        corners.append(((b * f - c * e) / across, (c * d - a * f) / across))
    return np.array(corners)


def _is_convex(corners: FloatArray) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    return bool(np.all(edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0))


def _shoelace_area(corners: FloatArray) -> float:
    """Return the area of corners (4, 2), negative where they are anticlockwise in the image."""
    following = np.roll(corners, -1, axis=0)
    return float(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]) / 2)


def _polygon_area(corners: FloatArray) -> float:
    return abs(_shoelace_area(corners))
