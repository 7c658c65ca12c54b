"""Detection in an image without a localised table: the network processes several scales of it."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.network.ball_model import BallModel, CentreModel
from detectors.network.peak_decoding import CandidateDetections, concatenate_candidates, select_non_echoes
from models.core.typing import ByteArray

SCALES = (1.0, 0.5, 0.25, 0.125)
"""Scales of the image."""
ACCEPTED_RADII_PX = (4.3, 10.5)
"""Radii that are accepted at one scale: neighbouring scales overlap a little."""
MIN_SCORE = 0.5
"""Least confidence score."""
MIN_SIDE_PX = 48
"""Least side of a scaled image."""


def detect_without_table(rgb: ByteArray, model: BallModel) -> CandidateDetections:
    """Detect balls of any size in an image.

    Args:
        rgb: Image (H, W, 3).
        model: Ball network.

    Returns:
        Candidates without echoes, px of the image, best first.
    """
    if not isinstance(model, CentreModel):
        candidates = model.find_candidates(rgb, float(min(rgb.shape[:2])))
        return candidates.take(candidates.score > MIN_SCORE)
    parts = [_detect_at_scale(rgb, model, scale) for scale in SCALES if scale * min(rgb.shape[:2]) >= MIN_SIDE_PX]
    candidates = concatenate_candidates(parts)
    candidates = candidates.take(np.argsort(-candidates.score, kind="stable"))
    return candidates.take(select_non_echoes(candidates))


def _detect_at_scale(rgb: ByteArray, model: CentreModel, scale: float) -> CandidateDetections:
    small = rgb
    if scale < 1:
        size = (max(round(rgb.shape[1] * scale), 1), max(round(rgb.shape[0] * scale), 1))
        small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    candidates = model.find_candidates(small, 7.0)
    low, high = ACCEPTED_RADII_PX if scale < 1 else (0.0, ACCEPTED_RADII_PX[1])
    good = (candidates.score > MIN_SCORE) & (candidates.radius >= low) & (candidates.radius < high)
    return candidates.take(good).scale(rgb.shape[1] / small.shape[1], (0.0, 0.0))
