"""A first look at what lies on the cloth: are there pockets, how large are the balls against the table."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.scene import Camera, Table, apply_homography
from video.table_cloth import cloth_likeness

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

PROBE_WIDTH = 960
"""px: balls are measured in pictures of at most this width."""
ROUNDNESS = 0.82
"""Least 4 pi area / perimeter^2 of a blob's hull for a ball; its area must fill 0.9 of the hull."""


@dataclass(frozen=True, slots=True)
class BallSizes:
    """Round things on the cloth, measured in shares of the table's length."""

    share: float
    """Their typical radius over the table's length; NaN where none was seen."""
    sigma: float
    """Its standard deviation."""
    count: int
    """Round things measured, all pictures together."""


def pocket_share(picture: Picture, outer: Floats, noses: Floats, cloth: Floats) -> float:
    """Share of six places behind corners and middles of the long noses, (4, 2) px each, where the cloth is broken.

    Near 1 with pockets, near 0 on a carom table, whose cushions run through.
    """
    angle, shade = cloth_likeness(picture, cloth)
    height, width = shade.shape
    broken = []
    for nose, edge in zip(_six(noses), _six(outer), strict=True):
        places = nose + np.linspace(0.15, 0.75, 7)[:, None] * (edge - nose)
        column = np.clip(np.rint(places[:, 0]).astype(int), 0, width - 1)
        row = np.clip(np.rint(places[:, 1]).astype(int), 0, height - 1)
        unlike = (angle[row, column] > 0.25) | (shade[row, column] < 0.45) | (shade[row, column] > 1.7)
        broken.append(float(np.mean(unlike)))
    return float(np.mean(np.array(broken) > 0.4))


def _six(corners: Floats) -> Floats:
    """Four corners and the middles, seen in perspective, of the two long sides (6, 2)."""
    from_square = cv2.getPerspectiveTransform(
        np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32), corners.astype(np.float32)
    )
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.0], [0.5, 1.0]])
    return apply_homography(from_square.astype(np.float64), square)


def ball_sizes(pictures: list[Picture], camera: Camera, table: Table, cloth: Floats) -> BallSizes:
    """Radii of round blobs inside the noses that are not of the cloth's colour."""
    shares = [share for picture in pictures for share in _round_blobs(picture, camera, table, cloth)]
    if not shares:
        return BallSizes(float("nan"), float("nan"), 0)
    values = np.array(shares)
    # Balls are the largest group of equal size; shadows, marks and heads make stragglers.
    votes = np.array([np.sum(np.abs(np.log(values / value)) < 0.08) for value in values])
    group = values[np.abs(np.log(values / values[int(np.argmax(votes))])) < 0.08]
    spread = float(np.std(group)) if len(group) > 2 else 0.05 * float(np.median(group))
    return BallSizes(float(np.median(group)), max(spread, 0.03 * float(np.median(group))), len(group))


def _round_blobs(picture: Picture, camera: Camera, table: Table, cloth: Floats) -> list[float]:
    scale = min(1.0, PROBE_WIDTH / picture.shape[1])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else picture
    angle, shade = cloth_likeness(small, cloth)
    strange = ((angle > 0.18) | (shade < 0.45) | (shade > 1.45)).astype(np.uint8)
    inside = np.zeros_like(strange)
    cv2.fillConvexPoly(inside, np.rint((camera.corners_px + 0.5) * scale - 0.5).astype(np.int32), 1)
    strange = cv2.morphologyEx(strange * inside, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    contours, _ = cv2.findContours(strange, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    shares = []
    for contour in contours:
        radius = _round_radius(contour)
        if radius is None:
            continue
        centre = (contour[:, 0].astype(np.float64).mean(axis=0) + 0.5) / scale - 0.5
        unit = table.ball_radius
        place = camera.to_table(centre, unit)
        share = radius / scale / float(camera.radius_px(place, unit)) * unit / table.length
        if 0.005 < share < 0.025:
            shares.append(share)
    return shares


def _round_radius(contour: NDArray[np.int32]) -> float | None:
    """Radius in px of a blob that is round and has no holes bitten into it."""
    hull = cv2.convexHull(contour)
    area, perimeter = float(cv2.contourArea(hull)), float(cv2.arcLength(hull, True))
    if area < 20 or 4 * np.pi * area / perimeter**2 < ROUNDNESS or cv2.contourArea(contour) < 0.88 * area:
        return None
    # A contour runs through the centres of the outermost pixels: half a pixel is missing all round.
    return float(np.sqrt(area / np.pi)) + 0.5
