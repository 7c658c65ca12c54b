"""Ball radius relative to the table, measured in images before the size of the table is known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import BallSize, Camera, Table
from models.core.typing import FloatArray, ImageArray
from models.physics.billiards.tables import BALL_RADIUS_RANGE
from video.calibration.cloth_region import compare_with_cloth, estimate_local_cloth_colour

# px: balls are measured in images whose longer side is at most this long.
PROBE_SIDE_PX = 960
# Smallest 4 pi area / perimeter^2 of a blob's hull for a ball.
MIN_ROUNDNESS = 0.75
# Smallest share of directions in which a ball's edge must lie on its circle.
MIN_RIM_SHARE = 0.6
# px, standard deviation between a ball's steepest edge and its rim (shading, stripes, blur) where presets are compared:
# cautious, because the noses of real tables are also misplaced, which changes the ratio by up to 5 %.
EDGE_SIGMA_PX = 0.6
# px, systematic standard deviation of the typical radius. On 14 clips with known balls (the sample clips, and eight of
# a snooker table) the radius was wrong by 0.16 px (root mean square) and at most 0.33 px.
SIZE_FLOOR_PX = 0.25
# Share of the spread between balls that all of them share. With it and `SIZE_FLOOR_PX`, the errors of the 14 clips and
# of four broadcasts are 0.8 standard deviations (root mean square) and at most 2.1.
SHARED_SPREAD = 0.5
# Number of measured objects in the typical group, and their share of all peers, from which they count as the balls.
MIN_GROUP_COUNT, MIN_GROUP_SHARE = 3, 0.5
# Radius, in that of the typical group, below which an object is no peer: no set has balls so unequal, and around one
# ball there may be more scraps (finger tips, chalk, the end of a cue) than balls.
MIN_PEER_SHARE = 0.6
# Ball radii between the places of an object in two images within which it is the same object at rest.
SAME_PLACE_RADII = 0.7
# Spots on the cloth, in quarters of the length along the middle: stickers of a fifth to a half of a ball's radius.
SPOT_QUARTERS = (1, 2, 3)
# Range of ball radius over table length: 0.0073 on a 12 ft snooker table, 0.0156 on a small pool table.
RADIUS_RATIO_RANGE = (0.005, 0.025)


@dataclass(frozen=True, slots=True)
class BallSizes:
    """Measured radius of the round objects on the cloth, relative to the length of the table."""

    radius_ratio: float
    """Their typical radius over the length of the table; NaN where none was measured."""
    sigma: float
    """Standard deviation of the ratio."""
    count: int
    """Number of objects in the typical group, over all images."""
    size_sigma: float = float("nan")
    """Standard deviation of the ratio if the table is located exactly; NaN where too few objects are alike."""

    def estimate_ball_size(self, table: Table) -> BallSize | None:
        """Estimate the radius of the balls on a table.

        Args:
            table: The table, whose length sets the scale.

        Returns:
            The estimate of source `image`; None where too few objects are alike, or their size is not that of a ball.
        """
        radius = self.radius_ratio * table.length
        if not (np.isfinite(self.size_sigma) and BALL_RADIUS_RANGE[0] < radius < BALL_RADIUS_RANGE[1]):
            return None
        return BallSize(radius, self.size_sigma * table.length, "image")


def measure_ball_sizes(images: list[ImageArray], background: ImageArray, camera: Camera, table: Table) -> BallSizes:
    """Measure the radii of round objects that lie inside the noses and differ from the cloth in colour.

    Args:
        images: frames of the clip, each (H, W, 3) RGB.
        background: (H, W, 3) the table without moving objects.
        camera: calibrated for `table`.
        table: any table of the right shape; its absolute size does not matter.

    Returns:
        The typical radius relative to the length of the table.
    """
    scale = min(1.0, PROBE_SIDE_PX / max(camera.width_px, camera.height_px))
    cloth = estimate_local_cloth_colour(background, round(camera.width_px * scale), round(camera.height_px * scale))
    blobs = [ball for image in images for ball in _measure_round_blobs(image, camera, table, cloth)]
    if not blobs:
        return BallSizes(float("nan"), float("nan"), 0)
    ratios, radii, x, y = _remove_spots(np.array(blobs), table).T
    # Balls form the largest group of equal size; shadows, marks and heads are outliers.
    votes = np.array([np.sum(np.abs(np.log(ratios / ratio)) < 0.08) for ratio in ratios])
    group = np.abs(np.log(ratios / ratios[int(np.argmax(votes))])) < 0.08
    count = int(group.sum())
    ratio = float(np.median(ratios[group]))
    relative_sigma = np.hypot(EDGE_SIGMA_PX / float(np.median(radii[group])), 0.12 / count)
    size_sigma = float("nan")
    peers = int(np.sum(ratios > MIN_PEER_SHARE * ratio))
    if count >= MIN_GROUP_COUNT and count >= MIN_GROUP_SHARE * peers:
        places = np.column_stack([x, y])[group]
        spread = _measure_spread_of_balls(ratios[group], places, SAME_PLACE_RADII * table.ball_radius)
        floor = SIZE_FLOOR_PX / float(np.median(radii[group]))
        size_sigma = ratio * float(np.linalg.norm([floor, SHARED_SPREAD * spread, 0.12 / count]))
    return BallSizes(ratio, ratio * float(relative_sigma), count, size_sigma)


def _remove_spots(blobs: FloatArray, table: Table) -> FloatArray:
    """Remove objects (K, 4) that lie on a spot of the table and are too small to be balls beside the largest one."""
    spots = np.array([[quarter * table.length / 4, table.width / 2] for quarter in SPOT_QUARTERS])
    away = np.linalg.norm(blobs[:, None, 2:] - spots, axis=-1).min(axis=1)
    is_small = blobs[:, 0] < MIN_PEER_SHARE * blobs[:, 0].max()
    return np.asarray(blobs[~(is_small & (away < SAME_PLACE_RADII * table.ball_radius))])


def _measure_spread_of_balls(ratios: FloatArray, places: FloatArray, reach: float) -> float:
    """Measure the robust relative spread of sizes (K,) between objects; those within `reach` (m) are the same one."""
    left, sizes = np.arange(len(ratios)), []
    while len(left):
        is_same = np.linalg.norm(places[left] - places[left[0]], axis=1) < reach
        sizes.append(float(np.median(ratios[left[is_same]])))
        left = left[~is_same]
    middle = float(np.median(sizes))
    return 1.4826 * float(np.median(np.abs(np.array(sizes) - middle))) / middle


def _measure_round_blobs(
    image: ImageArray, camera: Camera, table: Table, cloth: FloatArray
) -> list[tuple[float, float, float, float]]:
    """Measure the balls of an image: radii relative to the length of the table and in px, and places x, y in m."""
    size = (cloth.shape[1], cloth.shape[0])
    scale = size[0] / image.shape[1]
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    angle, shade = compare_with_cloth(small, cloth)
    foreign = ((angle > 0.18) | (shade < 0.45) | (shade > 1.45)).astype(np.uint8)
    corners = (camera.corners_px + 0.5) * scale - 0.5
    inside = np.zeros_like(foreign)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    # Lines on the cloth and cue tips that touch a ball are thinner than half of the smallest ball.
    thin = max(3, round(0.6 * RADIUS_RATIO_RANGE[0] * float(np.ptp(corners, axis=0).max())))
    foreign = cv2.morphologyEx(
        foreign * inside, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (thin, thin))
    )
    contours, _ = cv2.findContours(foreign, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    measured = []
    unit_radius, margin = table.ball_radius, 1.5 * table.ball_radius
    for contour in contours:
        estimate = _approximate_circle(contour, scale)
        circle = None if estimate is None else fit_circle(image, *estimate)
        if circle is None:
            continue
        centre, radius = circle
        place = camera.to_table(centre, unit_radius)
        # Balls at a cushion and objects in pockets are partly hidden: measure only free ones.
        if not (margin < place[0] < table.length - margin and margin < place[1] < table.width - margin):
            continue
        ratio = radius / float(camera.radius_px(place, unit_radius)) * unit_radius / table.length
        if RADIUS_RATIO_RANGE[0] < ratio < RADIUS_RATIO_RANGE[1]:
            measured.append((ratio, radius, float(place[0]), float(place[1])))
    return measured


def _approximate_circle(contour: NDArray[np.int32], scale: float) -> tuple[FloatArray, float] | None:
    """Return centre and radius (px of the original image) of a blob that is about round and complete, else None."""
    hull = cv2.convexHull(contour)
    area, perimeter = float(cv2.contourArea(hull)), float(cv2.arcLength(hull, True))
    if area < 12 or 4 * np.pi * area / perimeter**2 < MIN_ROUNDNESS or cv2.contourArea(contour) < 0.8 * area:
        return None
    moments = cv2.moments(hull)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    # A contour runs through the centres of the outermost pixels: half a pixel is missing on every side.
    return (centre + 0.5) / scale - 0.5, (np.sqrt(area / np.pi) + 0.5) / scale


def fit_circle(image: ImageArray, centre: FloatArray, radius: float) -> tuple[FloatArray, float] | None:
    """Fit the circle along which the image changes most steeply, near a rough one.

    The steepest position of an edge does not depend on a threshold, and the median over directions tolerates a shadow.

    Args:
        image: (H, W, 3) RGB.
        centre: (2,) px, rough centre.
        radius: px, rough radius.

    Returns:
        Centre (2,) and radius in px; None where no complete circle is found.
    """
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    for _ in range(2):
        radii = np.arange(0.5 * radius, 1.35 * radius + 1.5, 0.25)
        places = centre + radii[None, :, None] * rays[:, None]
        maps = places.astype(np.float32)
        colours = cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        lab = cv2.cvtColor(colours.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
        smooth = cv2.GaussianBlur(lab, (0, 0), sigmaX=3.0, sigmaY=0.01)
        steep = np.linalg.norm(np.gradient(smooth, axis=1), axis=2)
        edge = radii[_find_outermost_edges(steep)]
        points = centre + edge[:, None] * rays
        fitted = _fit_robust_circle(points)
        if fitted is None or not 0.5 * radius < fitted[1] < 1.5 * radius:
            return None
        centre, radius = fitted
    off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
    return (centre, radius) if np.mean(off < 0.1 * radius + 0.3) > MIN_RIM_SHARE else None


def _find_outermost_edges(steep: FloatArray) -> NDArray[np.int64]:
    """Find the outermost steep position on each ray (A, R): stripes, highlights and shading lie further in."""
    strong = steep > 0.75 * steep.max(axis=1, keepdims=True)
    peak = np.zeros_like(strong)
    peak[:, 1:-1] = strong[:, 1:-1] & (steep[:, 1:-1] >= steep[:, :-2]) & (steep[:, 1:-1] >= steep[:, 2:])
    last = steep.shape[1] - 1 - np.argmax(peak[:, ::-1], axis=1)
    return np.asarray(np.where(peak.any(axis=1), last, np.argmax(steep, axis=1)), np.int64)


def _fit_robust_circle(points: FloatArray) -> tuple[FloatArray, float] | None:
    """Fit centre and radius of the circle through most of the points (P, 2)."""
    weight = np.ones(len(points))
    centre, radius = points.mean(axis=0), 1.0
    for _ in range(8):
        a = np.column_stack([2 * points, np.ones(len(points))]) * weight[:, None]
        solution, _, rank, _ = np.linalg.lstsq(a, np.sum(points**2, axis=1) * weight, rcond=None)
        square = solution[2] + solution[:2] @ solution[:2]
        if rank < 3 or square <= 0:
            return None
        centre, radius = solution[:2], float(np.sqrt(square))
        off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        weight = 1 / np.maximum(off, 0.3)
    return centre, radius
