"""Pinhole camera from four corners: focal length, orientation and height, each with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table, apply_homography
from models.core.typing import FloatArray

# Prior mean of the focal length, in longer sides of the image: a field of view of 64 degrees, also held upright.
FOCAL_PRIOR_SIDES = 0.8
# Prior standard deviation of the logarithm of the focal length: 48 to 83 degrees, broadcast cameras to phones.
FOCAL_PRIOR_SIGMA = 0.35
# Standard deviation of the logarithm of length over width: tables are built 2:1, all presets within 1 %.
ASPECT_SIGMA = 0.01
# Length over width of small tables for homes, relative to 2:1, and the standard deviation of its logarithm: cushions of
# one width on a board of 2:1 leave 2.0 to 2.2.
HOME_ASPECT, HOME_ASPECT_SIGMA = 1.05, 0.06
# Squared standard deviations that such a shape costs: -2 log of the ratio of the densities of the two kinds at their
# means, if 3 of 100 filmed tables are of the second one.
HOME_COST = 11.0
# Standard deviation of the cosine between the sides.
SQUARE_SIGMA = 0.004


@dataclass(frozen=True, slots=True)
class PerspectiveFit:
    """Focal length with which a rectangle of known shape explains four corners, and the quality of the fit."""

    focal: float
    """px"""
    focal_sigma: float
    """Standard deviation of log(focal)."""
    aspect: float
    """Length over width at that focal length."""
    misfit: float
    """Deviation from shape and prior, in squared standard deviations."""


def homography_from_unit_square(corners: FloatArray) -> FloatArray:
    """Return the homography (3, 3) from the unit square (u right, v down) to corners (4, 2), clockwise from (0, 0)."""
    return homography_between(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), corners)


def homography_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the homography (3, 3) that maps four points (4, 2) exactly to four others."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    solution = np.linalg.solve(np.array(rows, dtype=np.float64), np.asarray(target, dtype=np.float64).ravel())
    return np.append(solution, 1.0).reshape(3, 3)


def fit_perspective(
    corners: FloatArray, width_px: int, height_px: int, aspect: float, corner_sigma: float
) -> PerspectiveFit:
    """Fit the focal length with which four corners look most like a rectangle.

    Args:
        corners: (4, 2) px.
        width_px: width of the image.
        height_px: height of the image.
        aspect: length of the first side over the second.
        corner_sigma: px, standard deviation of the corners.

    Returns:
        The posterior mean of the focal length, and the misfit of the best one.
    """
    focals = max(width_px, height_px) * np.exp(np.linspace(np.log(0.35), np.log(8.0), 240))
    cosine, ratio = _evaluate_shape(corners, width_px, height_px, focals)
    cosine_sigma, ratio_sigma = _estimate_shape_sigma(corners, width_px, height_px, focals, corner_sigma)
    cost = cosine**2 / (SQUARE_SIGMA**2 + cosine_sigma**2)
    usual = np.log(ratio / aspect) ** 2 / (ASPECT_SIGMA**2 + ratio_sigma**2)
    home = HOME_COST + np.log(ratio / (HOME_ASPECT * aspect)) ** 2 / (HOME_ASPECT_SIGMA**2 + ratio_sigma**2)
    cost += np.minimum(usual, home)
    cost += (np.log(focals / (FOCAL_PRIOR_SIDES * max(width_px, height_px))) / FOCAL_PRIOR_SIGMA) ** 2
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    mean = float(weight @ np.log(focals))
    sigma = float(np.sqrt(weight @ (np.log(focals) - mean) ** 2))
    best = int(np.argmin(cost))
    return PerspectiveFit(float(np.exp(mean)), sigma, float(ratio[best]), float(cost[best]))


def _evaluate_shape(
    corners: FloatArray, width_px: int, height_px: int, focals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the cosine between the two sides, and the ratio of their lengths, for each focal length."""
    h = homography_from_unit_square(corners)
    centre = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    first, second = h[:, 0].copy(), h[:, 1].copy()
    first[:2] -= centre * first[2]
    second[:2] -= centre * second[2]
    a = np.column_stack([first[:2][None] / focals[:, None], np.full(len(focals), first[2])])
    b = np.column_stack([second[:2][None] / focals[:, None], np.full(len(focals), second[2])])
    length_a, length_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    return np.sum(a * b, axis=1) / (length_a * length_b), length_a / length_b


def _estimate_shape_sigma(
    corners: FloatArray, width_px: int, height_px: int, focals: FloatArray, corner_sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Propagate the corner standard deviation (px) to the cosine and the logarithm of the ratio."""
    cosine, ratio = _evaluate_shape(corners, width_px, height_px, focals)
    cosine_variance, ratio_variance = np.zeros_like(cosine), np.zeros_like(ratio)
    for i in range(4):
        for axis in range(2):
            moved = corners.copy()
            moved[i, axis] += 0.5
            other_cosine, other_ratio = _evaluate_shape(moved, width_px, height_px, focals)
            cosine_variance += (2 * corner_sigma * (other_cosine - cosine)) ** 2
            ratio_variance += (2 * corner_sigma * np.log(other_ratio / ratio)) ** 2
    return np.sqrt(cosine_variance), np.sqrt(ratio_variance)


@dataclass(frozen=True, slots=True)
class ShapeEstimate:
    """Shape of a table by its corners in one view, without the assumption that it is a rectangle of 2:1."""

    angle: float
    """Degrees between the long and the short side."""
    angle_sigma: float
    """Degrees."""
    aspect: float
    """Length over width."""
    aspect_sigma: float


def estimate_shape(corners: FloatArray, covariance: FloatArray, width_px: int, height_px: int) -> ShapeEstimate:
    """Estimate the angle between the sides and their ratio, over the focal lengths that cameras have.

    In an oblique view both depend on the focal length, which nothing but the shape itself would tell: the errors are
    then large. From straight above they are those of the corners.

    Args:
        corners: (4, 2) px, in the order of `Table.corners`.
        covariance: (8, 8) px^2.
        width_px: width of the image.
        height_px: height of the image.

    Returns:
        Angle and ratio with their standard deviations.
    """
    logs = FOCAL_PRIOR_SIGMA * np.linspace(-2.5, 2.5, 41)
    focals = FOCAL_PRIOR_SIDES * max(width_px, height_px) * np.exp(logs)
    weight = np.exp(-0.5 * (logs / FOCAL_PRIOR_SIGMA) ** 2)
    weight /= weight.sum()
    cosine, ratio = _evaluate_shape(corners, width_px, height_px, focals)
    corner_sigma = float(np.sqrt(np.mean(np.diag(covariance))))
    cosine_sigma, ratio_sigma = _estimate_shape_sigma(corners, width_px, height_px, focals, corner_sigma)
    angle, angle_sigma = np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.degrees(cosine_sigma)
    values = []
    for one, sigma in ((angle, angle_sigma), (ratio, ratio_sigma * ratio)):
        mean = float(weight @ one)
        values += [mean, float(np.sqrt(weight @ ((one - mean) ** 2 + sigma**2)))]
    return ShapeEstimate(*values)


def orient_corners(
    corners: FloatArray, width_px: int, height_px: int, corner_sigma: float
) -> tuple[FloatArray, PerspectiveFit]:
    """Order corners like `Table.corners`, and fit the perspective.

    The longer side runs to the right in the image, or down where it is within 45 degrees of vertical.

    Args:
        corners: (4, 2) px, clockwise in the image.
        width_px: width of the image.
        height_px: height of the image.
        corner_sigma: px, standard deviation of the corners.

    Returns:
        The ordered corners (4, 2), and their perspective.
    """
    fits = [fit_perspective(np.roll(corners, -k, axis=0), width_px, height_px, 2.0, corner_sigma) for k in (0, 1)]
    first = 0 if fits[0].misfit <= fits[1].misfit else 1
    ordered = np.roll(corners, -first, axis=0)
    # x runs from corner 0 to 1; the sum of both long sides gives its direction in the image.
    along = (ordered[1] - ordered[0]) + (ordered[2] - ordered[3])
    is_reversed = along[0] < 0 if abs(along[0]) > abs(along[1]) else along[1] < 0
    return (np.roll(ordered, -2, axis=0) if is_reversed else ordered), fits[first]


def estimate_camera_position(homography: FloatArray, focal: float, width_px: int, height_px: int) -> FloatArray:
    """Estimate the camera position (3,), height last, over a plane that `homography` (3, 3) maps to pixels."""
    k = np.array([[focal, 0, (width_px - 1) / 2], [0, focal, (height_px - 1) / 2], [0, 0, 1.0]])
    rays = np.linalg.solve(k, homography)
    rays /= np.sqrt(np.linalg.norm(rays[:, 0]) * np.linalg.norm(rays[:, 1]))
    across = np.cross(rays[:, 0], rays[:, 1])
    across /= np.linalg.norm(across)
    position = np.linalg.solve(np.column_stack([rays[:, 0], rays[:, 1], across]), -rays[:, 2])
    return np.array([position[0], position[1], abs(position[2])])


def build_camera(
    corners: FloatArray,
    covariance: FloatArray,
    table: Table,
    perspective: PerspectiveFit,
    width_px: int,
    height_px: int,
) -> Camera:
    """Build the camera that maps the nose rectangle of a table to given corners.

    Args:
        corners: (4, 2) px, in the order of `Table.corners`.
        covariance: (8, 8) px^2 of the corners.
        perspective: focal length and its uncertainty.
        width_px: width of the image.
        height_px: height of the image.

    Returns:
        The calibrated camera.
    """
    nose_height = NOSE_HEIGHT_RADII * table.ball_radius
    h = homography_between(table.corners, corners)
    k = np.array([[perspective.focal, 0, (width_px - 1) / 2], [0, perspective.focal, (height_px - 1) / 2], [0, 0, 1.0]])
    rays = np.linalg.solve(k, h)
    scale = np.sqrt(np.linalg.norm(rays[:, 0]) * np.linalg.norm(rays[:, 1]))
    up = -np.cross(rays[:, 0], rays[:, 1])  # x right, y down in the image: up is towards the viewer
    vertical = k @ (up / np.linalg.norm(up) * scale)
    matrix = np.column_stack([h[:, 0], h[:, 1], vertical, h[:, 2] - nose_height * vertical])
    height = float(np.linalg.solve(matrix[:, :3], -matrix[:, 3])[2])
    return Camera(matrix, width_px, height_px, corners, covariance, "noses", height, height * perspective.focal_sigma)


# px, step of the numerical derivatives by the corners.
STEP_PX = 0.5


def estimate_place_sigma(camera: Camera, table: Table, xy: FloatArray) -> FloatArray:
    """Estimate the standard deviation of places relative to the noses.

    It has three parts: the corners, through the homography of their plane, the height of the camera, which shifts the
    centres of the balls against the plane of the corners, and the size of the table, which scales the distances to the
    nearer noses.

    Args:
        camera: Camera that was calibrated by the corners of the table.
        xy: Centres of balls (N, 2), m.

    Returns:
        Standard deviations (N, 2) of x and y, m.
    """
    z = table.ball_radius
    px = camera.to_pixels(xy, z)
    base = _map_by_corners(camera.corners_px, table, px)
    columns = []
    for k in range(8):
        corners = camera.corners_px.ravel().copy()
        corners[k] += STEP_PX
        columns.append((_map_by_corners(corners.reshape(4, 2), table, px) - base) / STEP_PX)
    jacobian = np.stack(columns, axis=-1)  # (N, 2, 8)
    variance = np.einsum("nij,jk,nik->ni", jacobian, camera.corner_covariance, jacobian)
    plane = NOSE_HEIGHT_RADII * table.ball_radius if camera.plane == "noses" else 0.0
    eye = camera.position
    parallax = abs(plane - z) * np.abs(xy - eye[:2]) / max(abs(float(eye[2])), z) ** 2
    distance = np.minimum(xy, [table.length, table.width] - xy)
    return np.asarray(np.sqrt(variance + (parallax * camera.height_sigma) ** 2 + (camera.scale_sigma * distance) ** 2))


def _map_by_corners(corners: FloatArray, table: Table, px: FloatArray) -> FloatArray:
    """Map pixels (N, 2) to the plane of corners (4, 2) px, m."""
    return apply_homography(homography_between(corners, table.corners), px)
