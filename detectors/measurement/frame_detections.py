"""Balls detected in one frame, and non-maximum suppression among those that cannot all be there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.measurement.ball_colour import find_flat_discs, measure_ball_colours
from models.core.array_columns import concatenate_rows, take_rows
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import BoolArray, ByteArray, FloatArray, IntArray

# Least distance of two balls on the table: two radii less the errors. Nearer than this, one of them is a false
# positive.
MIN_TABLE_DISTANCE_RADII = 1.75
# The same in the image, where one ball may hide part of another.
MIN_IMAGE_DISTANCE_RADII = 0.9

# Displacement during the exposure, ball radii, up to which shading is not blurred away.
MAX_SHARP_RADII = 0.5


@dataclass(frozen=True, slots=True)
class FrameDetections:
    """Balls in one frame; columns as in `Detections`, px of that frame."""

    centre: FloatArray
    radius: FloatArray
    streak: FloatArray
    score: FloatArray
    sigma: FloatArray
    sigma_along: FloatArray

    def __len__(self) -> int:
        return len(self.score)

    def take(self, rows: IntArray | BoolArray) -> FrameDetections:
        """Select rows."""
        return take_rows(self, rows)


NO_BALLS = FrameDetections(np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))


def merge_discs_and_streaks(discs: FrameDetections, streaks: FrameDetections) -> FrameDetections:
    """Merge streaks, first, and the discs outside them.

    Args:
        discs: Balls at rest.
        streaks: Moving balls.

    Returns:
        The streaks, then the discs.
    """
    is_outside = np.asarray(~is_inside_streaks(discs.centre, streaks).any(axis=0))
    return concatenate_rows([streaks, discs.take(is_outside)])


def is_inside_streaks(points: FloatArray, streaks: FrameDetections) -> BoolArray:
    """Test which points are covered by streaks.

    Args:
        points: Points (n, 2) px.
        streaks: K streaks; balls at rest count as discs.

    Returns:
        Mask (K, n).
    """
    length = np.maximum(np.linalg.norm(streaks.streak, axis=1), 1e-9)
    unit = streaks.streak / length[:, None]
    offset = points[None] - streaks.centre[:, None]
    along = np.clip(np.einsum("kni,ki->kn", offset, unit), -length[:, None] / 2, length[:, None] / 2)
    distance = np.linalg.norm(offset - along[..., None] * unit[:, None], axis=-1)
    return np.asarray(distance < streaks.radius[:, None])


def suppress_overlaps(detections: FrameDetections, scene: Scene, frame: int) -> FrameDetections:
    """Remove detections that cannot be there together with a better one.

    Args:
        detections: N balls of the frame.
        scene: Table and camera.
        frame: Number of the frame.

    Returns:
        The remaining balls, the best first.
    """
    radius = scene.table.ball_radius
    xy = scene.camera.to_table(detections.centre, radius, frame)
    is_apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1) > MIN_TABLE_DISTANCE_RADII * radius
    image_distance = np.linalg.norm(detections.centre[:, None] - detections.centre[None], axis=-1)
    is_apart &= image_distance > MIN_IMAGE_DISTANCE_RADII * detections.radius[:, None]
    return detections.take(select_compatible(detections, is_apart))


def select_compatible(detections: FrameDetections, is_compatible: BoolArray) -> IntArray:
    """Select pairwise compatible balls greedily: streaks first, then by confidence score.

    Args:
        detections: N balls.
        is_compatible: Mask (N, N) of pairs that can both be there.

    Returns:
        Rows (n,) in the order of selection.
    """
    rows: list[int] = []
    has_streak = np.linalg.norm(detections.streak, axis=1) > 0
    for row in np.lexsort((-detections.score, ~has_streak)).tolist():
        if is_compatible[row, rows].all():
            rows.append(row)
    return np.array(rows, dtype=np.int64)


def select_shaded(rgb: ByteArray, detections: FrameDetections) -> FrameDetections:
    """Select the detections that are no graphics drawn over the image, which are sharp discs of one brightness.

    Args:
        rgb: Image (H, W, 3) of the frame.
        detections: K balls.

    Returns:
        The balls that are shaded as spheres are, or too blurred to decide.
    """
    is_sharp = np.linalg.norm(detections.streak, axis=1) < MAX_SHARP_RADII * detections.radius
    return detections.take(~(is_sharp & find_flat_discs(rgb, detections.centre, detections.radius)))


def add_colours(rgb: ByteArray, detections: FrameDetections, frame: int) -> Detections:
    """Measure the colours of balls and number their frame.

    Args:
        rgb: Image (H, W, 3) of the frame.
        detections: K balls.
        frame: Number of the frame.

    Returns:
        The balls with colours, and scores clipped to [0, 1].
    """
    colours = measure_ball_colours(rgb, detections.centre, detections.radius)
    return Detections(
        np.full(len(detections), frame, dtype=np.int64),
        detections.centre,
        detections.radius,
        detections.streak,
        colours.colour,
        colours.white,
        colours.white_rim,
        colours.value,
        np.clip(detections.score, 0, 1),
        detections.sigma,
        detections.sigma_along,
    )
