"""Where the cloth is: the region of one colour that is shaped like a table, cushions included."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.io.pixel_kernels import dots

SEARCH_WIDTH = 480
"""Width in px of the reduced picture in which the cloth is looked for."""
LEAST_SHARE = 0.06
"""Share of the picture that a table must cover to be measured."""
LIGHT_WIDTH = 160
"""Width in px of the picture from which the light on the cloth is taken: balls are a few px there."""
LEAST_FILL = 0.5
"""Share of the quadrangle that must have the cloth's colour; players, shadows and balls take the rest."""
ANGLES = (0.07, 0.12, 0.2)
"""Tried angles between colour vectors (rad) within which a pixel has the hue of the cloth."""
SHADES = (0.35, 0.5, 0.65)
"""Tried brightnesses, relative to the cloth, above which a pixel of its hue belongs to it: cushions are shaded."""


@dataclass(frozen=True, slots=True)
class Cloth:
    """The cloth as a quadrangle along its outer edge, where the wood of the rails begins."""

    corners: FloatArray
    """(4, 2) px, clockwise in the picture."""
    colour: FloatArray
    """(3,) RGB, 0 to 255."""
    support: float
    """Share of the quadrangle's sides along which the region really ends, 0 to 1."""


@dataclass(frozen=True, slots=True)
class _Quadrangle:
    corners: FloatArray
    support: float


def find_cloths(picture: ImageArray, count: int = 3) -> list[Cloth]:
    """The most table-like regions of one colour in an RGB picture, best first, clearly different from each other."""
    scale = picture.shape[1] / SEARCH_WIDTH
    small = cv2.resize(picture, (SEARCH_WIDTH, round(picture.shape[0] / scale)), interpolation=cv2.INTER_AREA)
    found = [
        quadrangle
        for colour in dominant_colours(small)
        for mask in _masks(small, colour)
        if (quadrangle := _quadrangle(mask)) is not None
    ]
    best = max((one.support for one in found), default=0.0)
    # Regions without the cushions end as sharply as those with them: among equals the largest is the table.
    found.sort(key=lambda one: (one.support >= 0.95 * best, _area(one.corners) * one.support), reverse=True)
    different: list[_Quadrangle] = []
    for one in found:
        if all(_apart(one.corners, other.corners) > 4.0 for other in different):
            different.append(one)
    return [
        Cloth((one.corners + 0.5) * scale - 0.5, _colour_inside(small, one.corners), one.support)
        for one in different[:count]
    ]


def _apart(corners: FloatArray, others: FloatArray) -> float:
    """px by which two quadrangles differ at their worst corner, whichever they start from."""
    return float(np.linalg.norm(corners[:, None] - others[None], axis=2).min(axis=1).max())


def dominant_colours(picture: ImageArray, count: int = 5) -> list[FloatArray]:
    """The most frequent colours that are not nearly black: list of (3,) RGB means."""
    lab = cv2.cvtColor(picture, cv2.COLOR_RGB2LAB).reshape(-1, 3)
    keys = (lab[:, 0] >> 5).astype(np.int64) * 1024 + (lab[:, 1] >> 3).astype(np.int64) * 32 + (lab[:, 2] >> 3)
    votes = np.bincount(keys, minlength=8 * 1024).reshape(8, 32, 32).astype(np.float32)
    smooth = votes.copy()
    for axis in range(3):
        smooth += 0.5 * (np.roll(smooth, 1, axis) + np.roll(smooth, -1, axis))
    smooth[:2] = 0  # L* below 25: dark surroundings, not a lit cloth
    colours: list[FloatArray] = []
    pixels = picture.reshape(-1, 3)
    for _ in range(count):
        light, a, b = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
        near = (
            (np.abs((lab[:, 0] >> 5).astype(int) - light) <= 1)
            & (np.abs((lab[:, 1] >> 3).astype(int) - a) <= 1)
            & (np.abs((lab[:, 2] >> 3).astype(int) - b) <= 1)
        )
        if near.mean() >= LEAST_SHARE / 3:
            colours.append(np.median(pixels[near], axis=0).astype(np.float64))
        smooth[max(light - 1, 0) : light + 2, max(a - 2, 0) : a + 3, max(b - 2, 0) : b + 3] = 0
    return colours


def cloth_likeness(picture: ImageArray, colour: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Angle (rad) to the cloth's colour vector and brightness relative to it, both (H, W).

    `colour` is (3,) RGB, or (H, W, 3) where the light differs from place to place.
    """
    rgb, cloth = (levels.astype(np.float32).reshape(-1, 3) for levels in (picture, colour))
    length = np.sqrt(dots(rgb, rgb))
    usual = np.maximum(np.sqrt(dots(cloth, cloth)), 1)
    along = dots(rgb, cloth) / usual
    angle = np.arccos(np.clip(along / np.maximum(length, 1e-3), -1, 1)).astype(np.float32)
    return angle.reshape(picture.shape[:2]), (length / usual).astype(np.float32).reshape(picture.shape[:2])


def local_cloth(picture: ImageArray, width: int, height: int) -> FloatArray:
    """Colour of the cloth around each place (height, width, 3): the picture without anything of a ball's size."""
    tiny = cv2.resize(picture, (LIGHT_WIDTH, round(LIGHT_WIDTH * height / width)), interpolation=cv2.INTER_AREA)
    smooth = cv2.medianBlur(tiny, 13)
    large = cv2.resize(smooth.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large, np.float64)


def _colour_inside(small: ImageArray, corners: FloatArray) -> FloatArray:
    """Median colour (3,) inside corners (4, 2)."""
    inside = np.zeros(small.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    colour: FloatArray = np.median(small[inside > 0], axis=0).astype(np.float64)
    return colour


def _masks(small: ImageArray, colour: FloatArray) -> list[NDArray[np.uint8]]:
    angle, shade = cloth_likeness(cv2.GaussianBlur(small, (0, 0), 0.7), colour)
    return [((angle < a) & (shade > s) & (shade < 1.7)).astype(np.uint8) for a in ANGLES for s in SHADES]


def _quadrangle(mask: NDArray[np.uint8]) -> _Quadrangle | None:
    """Four long sides of the hull of the largest region, if they make a quadrangle."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    region = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel), cv2.MORPH_OPEN, kernel)
    contours, _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=cv2.contourArea)
    if cv2.contourArea(contour) < LEAST_SHARE * mask.size:
        return None
    hull = cv2.convexHull(contour)
    polygon = cv2.approxPolyDP(hull, 0.006 * cv2.arcLength(hull, True), True)[:, 0].astype(np.float64)
    corners = _best_sides(polygon, float(cv2.contourArea(hull)))
    if corners is None:
        return None
    corners = _snap(corners, contour[:, 0].astype(np.float64))
    if corners is None or cv2.contourArea(contour) < LEAST_FILL * _area(corners):
        return None
    if _filled(mask, corners) < LEAST_FILL:
        return None  # a frame of wood, not the cloth inside it
    return _Quadrangle(corners, _support(corners, contour, mask.shape))


def _filled(mask: NDArray[np.uint8], corners: FloatArray) -> float:
    """Share of the quadrangle (4, 2) that has the colour."""
    inside = np.zeros_like(mask)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    return float(mask[inside > 0].mean()) if inside.any() else 0.0


def _best_sides(polygon: FloatArray, area: float) -> FloatArray | None:
    """Of a convex polygon (K, 2) the four sides whose lines enclose it most tightly, as corners (4, 2)."""
    count = len(polygon)
    if count < 4:
        return None
    if _signed_area(polygon) < 0:
        polygon = polygon[::-1]
    lines = [line_through(polygon[i], polygon[(i + 1) % count]) for i in range(count)]
    lengths = np.array([np.linalg.norm(polygon[(i + 1) % count] - polygon[i]) for i in range(count)])
    best, best_score = None, -np.inf
    longest = sorted(np.argsort(-lengths)[:9])
    for chosen in combinations(longest, 4):
        corners = intersections([lines[i] for i in chosen])
        if corners is None or not _is_convex(corners):
            continue
        size = _area(corners)
        if not 0.97 * area < size < 1.6 * area:
            continue
        score = lengths[list(chosen)].sum() / lengths.sum() - 1.5 * (size / area - 1)
        if score > best_score:
            best, best_score = corners, score
    return best


def _snap(corners: FloatArray, contour: FloatArray) -> FloatArray | None:
    """Move each side onto the contour points (P, 2) that run along it (least squares with a narrowing gate)."""
    for gate in (6.0, 3.0, 1.5):
        lines = []
        for i in range(4):
            p, q = corners[i], corners[(i + 1) % 4]
            line = line_through(p, q)
            along = (contour - p) @ (q - p) / ((q - p) @ (q - p))
            near = (np.abs(contour @ line[:2] + line[2]) < gate) & (along > 0.06) & (along < 0.94)
            lines.append(_fit(contour[near]) if near.sum() >= 10 else line)
        snapped = intersections(lines)
        if snapped is None or not _is_convex(snapped):
            return None
        corners = snapped
    return corners


def _support(corners: FloatArray, contour: NDArray[np.int32], shape: tuple[int, ...]) -> float:
    """Share of the four sides (without their ends) that have a contour point within 2.5 px; bad sides count twice."""
    outline = np.ones(shape, np.uint8)
    outline[contour[:, 0, 1], contour[:, 0, 0]] = 0
    distance = cv2.distanceTransform(outline, cv2.DIST_L2, 3)
    shares = []
    for i in range(4):
        p, q = corners[i], corners[(i + 1) % 4]
        points = np.rint(p + np.linspace(0.1, 0.9, 60)[:, None] * (q - p)).astype(int)
        inside = np.all((points > 2) & (points < np.array([shape[1], shape[0]]) - 3), axis=1)
        column, row = np.clip(points[:, 0], 0, shape[1] - 1), np.clip(points[:, 1], 0, shape[0] - 1)
        shares.append(float(np.mean((distance[row, column] < 2.5) & inside)))
    return float(np.mean(shares) * min(1.0, min(shares) / 0.5))


def line_through(p: FloatArray, q: FloatArray) -> FloatArray:
    """Line (a, b, c), a x + b y + c = 0 with a unit normal, through two points."""
    direction = (q - p) / np.linalg.norm(q - p)
    normal = np.array([-direction[1], direction[0]])
    return np.array([normal[0], normal[1], -normal @ p])


def _fit(points: FloatArray) -> FloatArray:
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][1]
    return np.array([normal[0], normal[1], -normal @ centre])


def intersections(lines: list[FloatArray]) -> FloatArray | None:
    """Corners (4, 2) of four lines in cyclic order: corner i lies on lines i - 1 and i; None if two are parallel."""
    corners = []
    rows = [line.tolist() for line in lines]  # plain numbers: hundreds of combinations are tried
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


def _signed_area(corners: FloatArray) -> float:
    following = np.roll(corners, -1, axis=0)
    return float(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]) / 2)


def _area(corners: FloatArray) -> float:
    return abs(_signed_area(corners))
