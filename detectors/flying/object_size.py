"""What a calibrated camera says of a flying object before any image is seen: its size, and where it may be seen."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np

from models.core.court_camera import CourtCamera, CourtScene
from models.core.typing import BoolArray, FloatArray

# m above the floor below which rallies are played; a high clear leaves most pictures before.
CEILING = 10.0
# Radius, px, above which images are reduced before the search: a larger object shows nothing more, and costs more.
LARGEST_RADIUS_PX = 3.0


def choose_scale(scene: CourtScene) -> float:
    """Choose the size of the images that are searched, as a share of that of the frames."""
    sport = scene.sport
    middle = np.array([sport.length / 2, sport.width / 2, sport.net.height])
    return min(1.0, LARGEST_RADIUS_PX / apparent_size(scene.camera, middle, sport.object.radius))


def apparent_size(camera: CourtCamera, place: FloatArray, size: float) -> float:
    """Return the px of the reference image that a vertical size, m, takes at a place (3,); NaN behind the camera."""
    ends = camera.to_pixels(place + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, size]]))
    return float(np.linalg.norm(ends[1] - ends[0]))


def outline_of_play(scene: CourtScene, scale: float, frame: int) -> FloatArray | None:
    """Outline the part of a frame in which the object can be seen.

    Args:
        scene: Court and camera.
        scale: Working px per px.
        frame: Index of the frame in the file.

    Returns:
        (V, 2) working px, corners of a convex polygon; None where part of the space of play is behind the camera.
    """
    sport = scene.sport
    behind, beside = sport.surroundings
    box = product(
        (-behind, sport.length + behind), (-beside, sport.width + beside), (sport.floor, sport.floor + CEILING)
    )
    corners = scene.camera.to_pixels(np.array(list(box)), frame)
    if not np.isfinite(corners).all():
        return None
    return np.asarray(cv2.convexHull(((corners + 0.5) * scale - 0.5).astype(np.float32))[:, 0], np.float64)


def is_inside(outline: FloatArray | None, px: FloatArray) -> BoolArray:
    """Tell which places (K, 2) are inside a convex outline (V, 2)."""
    if outline is None:
        return np.ones(len(px), np.bool_)
    side = np.roll(outline, -1, axis=0) - outline
    off = px[:, None] - outline
    turn = side[:, 0] * off[..., 1] - side[:, 1] * off[..., 0]
    return np.asarray(np.all(turn >= 0, axis=1) | np.all(turn <= 0, axis=1))
