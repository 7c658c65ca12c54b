"""Balls in a picture whose table is not known: the network looks at several sizes of it."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.network.network_file import BallModel, CentreModel
from detectors.network.peak_decoding import Centres, chained, not_echoes
from models.core.typing import ByteArray

SCALES = (1.0, 0.5, 0.25, 0.125)
SEEN_RADII_PX = (4.3, 10.5)
"""Radii believed at one scale: two scales overlap a little."""
LEAST_SCORE = 0.5
LEAST_SIDE_PX = 48


def balls_anywhere(rgb: ByteArray, model: BallModel) -> Centres:
    """Balls of any size in a picture (H, W, 3), best first, px of the picture."""
    if not isinstance(model, CentreModel):
        seen = model.see(rgb, float(min(rgb.shape[:2])))
        return seen.take(seen.score > LEAST_SCORE)
    parts = [_at_scale(rgb, model, scale) for scale in SCALES if scale * min(rgb.shape[:2]) >= LEAST_SIDE_PX]
    found = chained(parts)
    found = found.take(np.argsort(-found.score, kind="stable"))
    return found.take(not_echoes(found))


def _at_scale(rgb: ByteArray, model: CentreModel, scale: float) -> Centres:
    small = rgb
    if scale < 1:
        size = (max(round(rgb.shape[1] * scale), 1), max(round(rgb.shape[0] * scale), 1))
        small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    seen = model.see(small, 7.0)
    low, high = SEEN_RADII_PX if scale < 1 else (0.0, SEEN_RADII_PX[1])
    good = (seen.score > LEAST_SCORE) & (seen.radius >= low) & (seen.radius < high)
    return seen.take(good).scaled(rgb.shape[1] / small.shape[1], (0.0, 0.0))
