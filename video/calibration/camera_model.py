"""From four corners to a pinhole camera: focal length, orientation, height, and how sure of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table
from models.core.typing import FloatArray

FOCAL_PRIOR = 0.8
"""Focal length in picture widths where the perspective does not tell: a horizontal field of view of 64 degrees."""
FOCAL_PRIOR_SIGMA = 0.35
"""One standard deviation of its logarithm: 48 to 83 degrees, broadcast cameras to phones."""
ASPECT_SIGMA = 0.01
"""Standard deviation of the logarithm of length over width: tables are built 2:1, preset by preset within 1 %."""
SQUARE_SIGMA = 0.004
"""Standard deviation of the cosine between the sides."""


@dataclass(frozen=True, slots=True)
class View:
    """How well a rectangle of a known shape explains four corners."""

    focal: float
    """px"""
    focal_sigma: float
    """Standard deviation of log(focal)."""
    aspect: float
    """Length over width at that focal length."""
    misfit: float
    """Squared standard deviations by which shape and prior are missed."""


def square_to_quad(corners: FloatArray) -> FloatArray:
    """Homography (3, 3) from the unit square (u right, v down) to four corners (4, 2), clockwise from the origin."""
    return homography_between(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), corners)


def homography_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """The homography (3, 3) that takes four points (4, 2) exactly to four others."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    solution = np.linalg.solve(np.array(rows, dtype=np.float64), np.asarray(target, dtype=np.float64).ravel())
    return np.append(solution, 1.0).reshape(3, 3)


def best_view(corners: FloatArray, width_px: int, height_px: int, aspect: float, corner_sigma: float) -> View:
    """The focal length with which corners (4, 2) look most like a rectangle of `aspect` (first side over second)."""
    focals = width_px * np.exp(np.linspace(np.log(0.35), np.log(8.0), 240))
    cosine, ratio = _shape(corners, width_px, height_px, focals)
    cosine_sigma, ratio_sigma = _shape_sigma(corners, width_px, height_px, focals, corner_sigma)
    cost = cosine**2 / (SQUARE_SIGMA**2 + cosine_sigma**2)
    cost += np.log(ratio / aspect) ** 2 / (ASPECT_SIGMA**2 + ratio_sigma**2)
    cost += (np.log(focals / (FOCAL_PRIOR * width_px)) / FOCAL_PRIOR_SIGMA) ** 2
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    mean = float(weight @ np.log(focals))
    sigma = float(np.sqrt(weight @ (np.log(focals) - mean) ** 2))
    best = int(np.argmin(cost))
    return View(float(np.exp(mean)), sigma, float(ratio[best]), float(cost[best]))


def _shape(corners: FloatArray, width_px: int, height_px: int, focals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cosine between the two sides, and the ratio of their lengths, for each focal length."""
    h = square_to_quad(corners)
    centre = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    first, second = h[:, 0].copy(), h[:, 1].copy()
    first[:2] -= centre * first[2]
    second[:2] -= centre * second[2]
    a = np.column_stack([first[:2][None] / focals[:, None], np.full(len(focals), first[2])])
    b = np.column_stack([second[:2][None] / focals[:, None], np.full(len(focals), second[2])])
    length_a, length_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    return np.sum(a * b, axis=1) / (length_a * length_b), length_a / length_b


def _shape_sigma(
    corners: FloatArray, width_px: int, height_px: int, focals: FloatArray, corner_sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of the cosine and of the logarithm of the ratio from that of the corners (px)."""
    cosine, ratio = _shape(corners, width_px, height_px, focals)
    cosine_variance, ratio_variance = np.zeros_like(cosine), np.zeros_like(ratio)
    for i in range(4):
        for axis in range(2):
            moved = corners.copy()
            moved[i, axis] += 0.5
            other_cosine, other_ratio = _shape(moved, width_px, height_px, focals)
            cosine_variance += (2 * corner_sigma * (other_cosine - cosine)) ** 2
            ratio_variance += (2 * corner_sigma * np.log(other_ratio / ratio)) ** 2
    return np.sqrt(cosine_variance), np.sqrt(ratio_variance)


def orient(corners: FloatArray, width_px: int, height_px: int, corner_sigma: float) -> tuple[FloatArray, View]:
    """Corners (4, 2), clockwise in the picture, in the order of `Table.corners`, and the view of them.

    The longer side runs to the right of the picture, or down where it stands within 45 degrees of vertical.
    """
    views = [best_view(np.roll(corners, -k, axis=0), width_px, height_px, 2.0, corner_sigma) for k in (0, 1)]
    first = 0 if views[0].misfit <= views[1].misfit else 1
    ordered = np.roll(corners, -first, axis=0)
    # x runs from corner 0 to 1; both long sides together give its direction in the picture.
    along = (ordered[1] - ordered[0]) + (ordered[2] - ordered[3])
    backwards = along[0] < 0 if abs(along[0]) > abs(along[1]) else along[1] < 0
    return (np.roll(ordered, -2, axis=0) if backwards else ordered), views[first]


def eye_over(homography: FloatArray, focal: float, width_px: int, height_px: int) -> FloatArray:
    """Where the camera stands (3,) over a plane that `homography` (3, 3) takes to pixels; the last is its height."""
    k = np.array([[focal, 0, (width_px - 1) / 2], [0, focal, (height_px - 1) / 2], [0, 0, 1.0]])
    rays = np.linalg.solve(k, homography)
    rays /= np.sqrt(np.linalg.norm(rays[:, 0]) * np.linalg.norm(rays[:, 1]))
    across = np.cross(rays[:, 0], rays[:, 1])
    across /= np.linalg.norm(across)
    eye = np.linalg.solve(np.column_stack([rays[:, 0], rays[:, 1], across]), -rays[:, 2])
    return np.array([eye[0], eye[1], abs(eye[2])])


def camera_from_corners(
    corners: FloatArray, covariance: FloatArray, table: Table, view: View, width_px: int, height_px: int
) -> Camera:
    """The camera that sees the nose rectangle of `table` at corners (4, 2) px and has the view's focal length."""
    nose_height = NOSE_HEIGHT_RADII * table.ball_radius
    h = homography_between(table.corners, corners)
    k = np.array([[view.focal, 0, (width_px - 1) / 2], [0, view.focal, (height_px - 1) / 2], [0, 0, 1.0]])
    rays = np.linalg.solve(k, h)
    scale = np.sqrt(np.linalg.norm(rays[:, 0]) * np.linalg.norm(rays[:, 1]))
    up = -np.cross(rays[:, 0], rays[:, 1])  # x right, y down in the picture: up is towards the viewer
    vertical = k @ (up / np.linalg.norm(up) * scale)
    matrix = np.column_stack([h[:, 0], h[:, 1], vertical, h[:, 2] - nose_height * vertical])
    height = float(np.linalg.solve(matrix[:, :3], -matrix[:, 3])[2])
    return Camera(matrix, width_px, height_px, corners, covariance, "noses", height, height * view.focal_sigma)
