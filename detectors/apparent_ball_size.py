"""Correction of the ball size where the calibration has it wrong.

If an 8-foot table is taken for a 9-foot one, or the balls of a pub table are small, balls appear up to a quarter larger
or smaller than predicted. They are all equally large, so one factor corrects it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detectors.hough.hough_detector import build_hough_detector
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import ByteArray

RADIUS_FACTORS = (0.8, 0.89, 1.0, 1.12, 1.25)
"""Trial radii over the predicted one; a circle fit covers 5 % to either side of each."""
MAX_RADIUS_DEVIATION = 0.04
"""Relative difference of measured and predicted radius up to which the prediction is kept."""
GOOD_SCORE_SHARE = 0.93
"""Share of the best trial's score from which trials are equivalent; the one nearest to the prediction is selected."""
MAX_ITERATIONS = 3
MIN_CLEAR_SCORE = 0.9


def correct_ball_size(scene: Scene, images: list[tuple[int, ByteArray]]) -> Scene:
    """Correct the ball radius of a scene to the one measured in some images.

    Args:
        scene: Table and camera.
        images: Frame number and image (H, W, 3) of some frames.

    Returns:
        The scene with the measured radius; the same object if the prediction is right or no ball is clear.
    """
    score, ratio = _score_ball_size(scene, images, 1.0)
    if score > 0 and abs(ratio - 1) <= MAX_RADIUS_DEVIATION:
        return scene
    trials = {factor: _score_ball_size(scene, images, factor) for factor in RADIUS_FACTORS}
    enough = GOOD_SCORE_SHARE * max(score for score, _ in trials.values())
    if enough == 0:
        return scene
    factor = min((f for f, (score, _) in trials.items() if score >= enough), key=lambda f: abs(f - 1))
    ratio = trials[factor][1]
    for _ in range(MAX_ITERATIONS):
        factor *= ratio
        if abs(ratio - 1) <= MAX_RADIUS_DEVIATION:
            break
        ratio = _score_ball_size(scene, images, factor)[1]
    return _scale_ball_radius(scene, factor)


def _score_ball_size(scene: Scene, images: list[tuple[int, ByteArray]], factor: float) -> tuple[float, float]:
    """Score `factor` times the predicted radius: sum of the clear scores, and median of measured over this radius."""
    resized = _scale_ball_radius(scene, factor)
    finder = build_hough_detector(resized, images)
    detections = [finder.detect(rgb, frame) for frame, rgb in images]
    scores = np.concatenate([part.score[_is_clear(part)] for part in detections])
    ratios = np.concatenate([_radius_ratios(part, resized) for part in detections])
    return float(scores.sum()), float(np.median(ratios)) if len(ratios) else 1.0


def _is_clear(detections: Detections) -> NDArray[np.bool_]:
    sharp = np.linalg.norm(detections.streak, axis=1) == 0
    clear: NDArray[np.bool_] = sharp & (detections.score > MIN_CLEAR_SCORE)
    return clear


def _radius_ratios(detections: Detections, scene: Scene) -> NDArray[np.float64]:
    """Measured over predicted radius of the clear balls."""
    clear = _is_clear(detections)
    radius = scene.table.ball_radius
    place = scene.camera.to_table(detections.centre[clear], radius, detections.frame[clear])
    ratios: NDArray[np.float64] = detections.radius[clear] / scene.camera.radius_px(place, radius)
    return ratios


def _scale_ball_radius(scene: Scene, factor: float) -> Scene:
    return replace(scene, table=replace(scene.table, ball_radius=scene.table.ball_radius * factor))
