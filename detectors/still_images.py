"""Detection in a single image: on the table in it, or anywhere if there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.detect import detect_in_image, select_model_file
from detectors.detect_options import DetectOptions
from detectors.network.ball_model import open_ball_model
from detectors.network.peak_decoding import APPEARANCES
from detectors.select_detector import explain_selection
from detectors.table_free_detection import detect_without_table
from models.core.detections import Detections
from models.core.errors import TableNotFound
from models.core.scene import Game
from models.core.typing import ByteArray, FloatArray
from models.tracking.appearance import Appearance
from models.tracking.ball_classes import classify_balls
from video.calibration.table_finder import calibrate_image
from video.io.video_options import CalibrateOptions

KIND_OF_APPEARANCE = {"white": "cue", "black": "eight", "coloured": "solid", "striped": "stripe"}
"""Kind of a ball without a table, by its appearance: the kinds of pool, which has all four appearances."""
MIN_APPEARANCE_PROBABILITY = 0.6
"""Probability of an appearance from which the kind is named."""


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
        TableNotFound: There is no table, and the options do not request a network, which needs none.
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
    best = [
        int(np.argmax(look)) if np.nanmax(look, initial=0.0) > MIN_APPEARANCE_PROBABILITY else -1
        for look in candidates.appearance
    ]
    kinds = tuple("ball" if k < 0 else KIND_OF_APPEARANCE[APPEARANCES[k]] for k in best)
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
