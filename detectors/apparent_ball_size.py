"""The size that the balls are seen with, where the calibration has it wrong.

A table taken for a 9-foot one that is an 8-foot one, or small balls on a pub table: the balls then look up to a
quarter larger or smaller than predicted. They are all equally large, so one factor puts it right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detectors.hough.hough_detector import ball_finder
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import ByteArray

FACTORS = (0.8, 0.89, 1.0, 1.12, 1.25)
"""Radii that are tried, over the predicted one; a circle fit reaches 5 % to either side of each."""
AGREED = 0.04
"""Relative difference of seen and predicted radius up to which the prediction is taken."""
GOOD_SHARE = 0.93
"""Of the best trial's score: among trials this good the one nearest to the prediction is believed."""
REPEATS = 3
CLEAR_SCORE = 0.9


def with_seen_size(scene: Scene, pictures: list[tuple[int, ByteArray]]) -> Scene:
    """The scene with the ball radius as seen in (frame, picture (H, W, 3)); unchanged where no ball is clear."""
    score, seen = _tried(scene, pictures, 1.0)
    if score > 0 and abs(seen - 1) <= AGREED:
        return scene
    trials = {factor: _tried(scene, pictures, factor) for factor in FACTORS}
    enough = GOOD_SHARE * max(score for score, _ in trials.values())
    if enough == 0:
        return scene
    factor = min((f for f, (score, _) in trials.items() if score >= enough), key=lambda f: abs(f - 1))
    seen = trials[factor][1]
    for _ in range(REPEATS):
        factor *= seen
        if abs(seen - 1) <= AGREED:
            break
        seen = _tried(scene, pictures, factor)[1]
    return _resized(scene, factor)


def _tried(scene: Scene, pictures: list[tuple[int, ByteArray]], factor: float) -> tuple[float, float]:
    """How well balls of `factor` times the predicted size fit: sum of clear scores, their seen size over this one."""
    resized = _resized(scene, factor)
    finder = ball_finder(resized, pictures)
    found = [finder.look(rgb, frame) for frame, rgb in pictures]
    scores = np.concatenate([part.score[_clear(part)] for part in found])
    ratios = np.concatenate([_ratios(part, resized) for part in found])
    return float(scores.sum()), float(np.median(ratios)) if len(ratios) else 1.0


def _clear(found: Detections) -> NDArray[np.bool_]:
    sharp = np.linalg.norm(found.streak, axis=1) == 0
    clear: NDArray[np.bool_] = sharp & (found.score > CLEAR_SCORE)
    return clear


def _ratios(found: Detections, scene: Scene) -> NDArray[np.float64]:
    """Seen over predicted radius of the clear balls."""
    clear = _clear(found)
    radius = scene.table.ball_radius
    place = scene.camera.to_table(found.centre[clear], radius, found.frame[clear])
    ratios: NDArray[np.float64] = found.radius[clear] / scene.camera.radius_px(place, radius)
    return ratios


def _resized(scene: Scene, factor: float) -> Scene:
    return replace(scene, table=replace(scene.table, ball_radius=scene.table.ball_radius * factor))
