"""Detection in a single image: on the table in it, or anywhere if there is none."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.detect import detect_in_image, select_model_file
from detectors.detect_options import DetectOptions
from detectors.network.ball_model import BallModel, CentreModel, open_ball_model
from detectors.network.peak_decoding import APPEARANCES, CandidateDetections, concatenate_candidates, select_non_echoes
from detectors.select_detector import explain_selection
from models.core.detections import Detections
from models.core.errors import TableNotFound
from models.core.scene import Game
from models.core.typing import ByteArray, FloatArray
from models.tracking.ball_classes import POOL_SET, Appearance, assign_to_set, classify_balls
from video.calibration.table_finder import calibrate_image
from video.io.video_options import CalibrateOptions

# Kind of a ball without a table, by its appearance: the kinds of pool, which has all four appearances.
KIND_OF_APPEARANCE = {"white": "cue", "black": "eight", "coloured": "solid", "striped": "stripe"}
# Probability of an appearance from which the kind is named.
MIN_APPEARANCE_PROBABILITY = 0.6


@dataclass(frozen=True, slots=True)
class StillDetections:
    """The K balls of an image, from left to right."""

    centre: FloatArray
    """(K, 2) px."""
    radius: FloatArray
    """(K,) px."""
    kind: tuple[str, ...]
    """(K,) of `models.core.tracks.KINDS`."""
    score: FloatArray
    """(K,) confidence scores in [0, 1]."""
    sigma: FloatArray
    """(K,) px per axis."""
    note: str = ""
    """A sentence about a problem; empty without one."""
    detector: str = "onnx: it needs no table"
    """The detector that was used, and the reason."""


def detect_in_still(rgb: ByteArray, name: str, detect: DetectOptions, calibrate: CalibrateOptions) -> StillDetections:
    """Detect and classify the balls in a single image.

    Args:
        rgb: Image (H, W, 3).
        name: Name of the image, for messages.
        detect: Which detector and network.
        calibrate: Options of the table localisation.

    Returns:
        The balls.

    Raises:
        TableNotFound: There is no table, and the options do not request a network, which would need no table.
        ModelError: The file of the network cannot be used.
    """
    try:
        scene = calibrate_image(rgb, calibrate, name)
    except TableNotFound as missing:
        if detect.detector != "onnx" and detect.model is None:
            raise
        return _detect_without_table(rgb, detect, f"{missing}; balls were searched for in the whole image")
    detections = detect_in_image(rgb, scene, detect)
    kinds = classify_detections(detections, scene.table.game)
    made_by = explain_selection(detect, scene, is_still=True)
    return _sort_left_to_right(
        StillDetections(
            detections.centre, detections.radius, kinds, detections.score, detections.sigma, detector=made_by
        )
    )


def classify_detections(detections: Detections, game: Game) -> tuple[str, ...]:
    """Classify the balls of a single image.

    Args:
        detections: The K balls of the image.
        game: Game that the table is for.

    Returns:
        One of `models.core.tracks.KINDS` per ball.
    """
    looks = Appearance(detections.colour, detections.white, detections.white, detections.white_rim, detections.value)
    return classify_balls(looks, game)


def _detect_without_table(rgb: ByteArray, detect: DetectOptions, note: str) -> StillDetections:
    candidates = detect_without_table(rgb, open_ball_model(select_model_file(detect)))
    unlikeliness = -np.log(np.clip(np.nan_to_num(candidates.appearance), 1e-6, 1.0))
    sizes = {kind: POOL_SET[kind] for kind in (KIND_OF_APPEARANCE[name] for name in APPEARANCES)}
    kinds = assign_to_set(unlikeliness, sizes, -np.log(MIN_APPEARANCE_PROBABILITY))
    return _sort_left_to_right(
        StillDetections(
            candidates.centre,
            candidates.radius,
            kinds,
            candidates.score,
            np.maximum(candidates.sigma_across, candidates.sigma_along),
            note,
        )
    )


def _sort_left_to_right(balls: StillDetections) -> StillDetections:
    order = np.lexsort((balls.centre[:, 1], balls.centre[:, 0]))
    kinds = tuple(balls.kind[k] for k in order)
    columns = (balls.radius[order], kinds, balls.score[order], balls.sigma[order])
    return StillDetections(balls.centre[order], *columns, balls.note, balls.detector)


# Scales of the image.
SCALES = (1.0, 0.5, 0.25, 0.125)
# Radii that are accepted at one scale: neighbouring scales overlap a little.
ACCEPTED_RADII_PX = (4.3, 10.5)
# Least confidence score.
MIN_SCORE = 0.5
# Least side of a scaled image.
MIN_SIDE_PX = 48


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
