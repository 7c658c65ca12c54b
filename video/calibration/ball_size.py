"""A first look at what lies on the cloth: how large are the balls against the table."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Camera, Table
from models.core.typing import FloatArray, ImageArray
from video.calibration.cloth_region import cloth_likeness, local_cloth

PROBE_WIDTH = 960
"""px: balls are measured in pictures of at most this width."""
ROUNDNESS = 0.75
"""Least 4 pi area / perimeter^2 of a blob's hull for a ball."""
WHOLE = 0.6
"""Share of directions in which a ball's edge must lie on its circle."""
EDGE_DOUBT = 0.6
"""px by which a ball's steepest edge may differ from its rim: shading, stripes, blur."""
SHARES = (0.005, 0.025)
"""Radii over table length that a ball may have: 0.0073 on a 12 ft snooker table, 0.0156 on a small pool table."""


@dataclass(frozen=True, slots=True)
class BallSizes:
    """Round things on the cloth, measured in shares of the table's length."""

    share: float
    """Their typical radius over the table's length; NaN where none was seen."""
    sigma: float
    """Its standard deviation."""
    count: int
    """Round things measured, all pictures together."""


def ball_sizes(pictures: list[ImageArray], background: ImageArray, camera: Camera, table: Table) -> BallSizes:
    """Radii of round things that lie inside the noses and are not of the cloth's colour.

    `background` is the table without what moves; `camera` is calibrated for `table`, of which only the shape counts.
    """
    scale = min(1.0, PROBE_WIDTH / camera.width_px)
    cloth = local_cloth(background, round(camera.width_px * scale), round(camera.height_px * scale))
    seen = [ball for picture in pictures for ball in _round_blobs(picture, camera, table, cloth)]
    if not seen:
        return BallSizes(float("nan"), float("nan"), 0)
    shares, radii = np.array(seen).T
    # Balls are the largest group of equal size; shadows, marks and heads make stragglers.
    votes = np.array([np.sum(np.abs(np.log(shares / share)) < 0.08) for share in shares])
    group = np.abs(np.log(shares / shares[int(np.argmax(votes))])) < 0.08
    count = int(group.sum())
    share = float(np.median(shares[group]))
    doubt = np.hypot(EDGE_DOUBT / float(np.median(radii[group])), 0.12 / count)
    return BallSizes(share, share * float(doubt), count)


def _round_blobs(picture: ImageArray, camera: Camera, table: Table, cloth: FloatArray) -> list[tuple[float, float]]:
    """Radii of balls in a picture, in shares of the table's length and in px."""
    size = (cloth.shape[1], cloth.shape[0])
    scale = size[0] / picture.shape[1]
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    angle, shade = cloth_likeness(small, cloth)
    strange = ((angle > 0.18) | (shade < 0.45) | (shade > 1.45)).astype(np.uint8)
    corners = (camera.corners_px + 0.5) * scale - 0.5
    inside = np.zeros_like(strange)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    # Lines on the cloth and cue tips that touch a ball are thinner than half of the smallest ball.
    thin = max(3, round(0.6 * SHARES[0] * float(np.ptp(corners[:, 0]))))
    strange = cv2.morphologyEx(
        strange * inside, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (thin, thin))
    )
    contours, _ = cv2.findContours(strange, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    balls = []
    unit, margin = table.ball_radius, 1.5 * table.ball_radius
    for contour in contours:
        rough = _rough_circle(contour, scale)
        circle = None if rough is None else fit_circle(picture, *rough)
        if circle is None:
            continue
        centre, radius = circle
        place = camera.to_table(centre, unit)
        # Balls on a cushion and things in pockets are cut off: measure those that lie free.
        if not (margin < place[0] < table.length - margin and margin < place[1] < table.width - margin):
            continue
        share = radius / float(camera.radius_px(place, unit)) * unit / table.length
        if SHARES[0] < share < SHARES[1]:
            balls.append((share, radius))
    return balls


def _rough_circle(contour: NDArray[np.int32], scale: float) -> tuple[FloatArray, float] | None:
    """Centre and radius in px of the original picture of a blob that is about round and whole."""
    hull = cv2.convexHull(contour)
    area, perimeter = float(cv2.contourArea(hull)), float(cv2.arcLength(hull, True))
    if area < 12 or 4 * np.pi * area / perimeter**2 < ROUNDNESS or cv2.contourArea(contour) < 0.8 * area:
        return None
    moments = cv2.moments(hull)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    # A contour runs through the centres of the outermost pixels: half a pixel is missing all round.
    return (centre + 0.5) / scale - 0.5, (np.sqrt(area / np.pi) + 0.5) / scale


def fit_circle(picture: ImageArray, centre: FloatArray, radius: float) -> tuple[FloatArray, float] | None:
    """The circle along which the picture changes most steeply, near a rough one; None if there is no whole circle.

    The steepest place of an edge does not move with a threshold, and the median over directions forgives a shadow.
    """
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    for _ in range(2):
        radii = np.arange(0.5 * radius, 1.35 * radius + 1.5, 0.25)
        places = centre + radii[None, :, None] * rays[:, None]
        maps = places.astype(np.float32)
        colours = cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        lab = cv2.cvtColor(colours.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
        smooth = cv2.GaussianBlur(lab, (0, 0), sigmaX=3.0, sigmaY=0.01)
        steep = np.linalg.norm(np.gradient(smooth, axis=1), axis=2)
        edge = radii[_outermost_edge(steep)]
        points = centre + edge[:, None] * rays
        fitted = _circle_through(points)
        if fitted is None or not 0.5 * radius < fitted[1] < 1.5 * radius:
            return None
        centre, radius = fitted
    off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
    return (centre, radius) if np.mean(off < 0.1 * radius + 0.3) > WHOLE else None


def _outermost_edge(steep: FloatArray) -> NDArray[np.int64]:
    """Index of the outermost steep place on each ray (A, R): stripes, highlights and shaded limbs lie further in."""
    strong = steep > 0.75 * steep.max(axis=1, keepdims=True)
    peak = np.zeros_like(strong)
    peak[:, 1:-1] = strong[:, 1:-1] & (steep[:, 1:-1] >= steep[:, :-2]) & (steep[:, 1:-1] >= steep[:, 2:])
    last = steep.shape[1] - 1 - np.argmax(peak[:, ::-1], axis=1)
    return np.asarray(np.where(peak.any(axis=1), last, np.argmax(steep, axis=1)), np.int64)


def _circle_through(points: FloatArray) -> tuple[FloatArray, float] | None:
    """Centre and radius of the circle through most of the points (P, 2)."""
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
