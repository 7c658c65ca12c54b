"""Balls in one still picture: on the table that is found in it, or anywhere where none is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.detect import detect_in_picture, model_file
from detectors.network.network_file import open_model
from detectors.network.peak_decoding import LOOKS
from detectors.network.table_free_detection import balls_anywhere
from detectors.options import DetectOptions
from detectors.select_detector import why_chosen
from models.core.errors import TableNotFound
from models.core.typing import ByteArray, FloatArray
from models.tracking.appearance import Look
from models.tracking.ball_classes import name_kinds
from video.calibration.table_finder import scene_in_picture
from video.io.options import CalibrateOptions

KIND_OF_LOOK = {"white": "cue", "black": "eight", "coloured": "solid", "striped": "stripe"}
"""What a ball is called whose table is not known: the names of pool, which has all four looks."""
CLEAR_LOOK = 0.6


@dataclass(frozen=True, slots=True)
class StillBalls:
    """The K balls of a picture, from left to right."""

    centre: FloatArray
    """(K, 2) px."""
    radius: FloatArray
    kind: tuple[str, ...]
    """(K,) of `models.core.tracks.KINDS`."""
    score: FloatArray
    sigma: FloatArray
    """(K,) px per axis."""
    note: str = ""
    """A sentence on what was not as it should be."""
    made_by: str = "onnx: it needs no table"
    """Which detector saw them, and why."""


def balls_in_still(rgb: ByteArray, name: str, detect: DetectOptions, calibrate: CalibrateOptions) -> StillBalls:
    """The balls in a picture (H, W, 3); TableNotFound where there is no table and no network to do without."""
    try:
        scene = scene_in_picture(rgb, calibrate, name)
    except TableNotFound as missing:
        if detect.detector != "onnx" and detect.model is None:
            raise
        return _anywhere(rgb, detect, f"{missing}; balls were looked for in the whole picture")
    seen = detect_in_picture(rgb, scene, detect)
    kinds = name_kinds(Look(seen.colour, seen.white, seen.white, seen.white_rim, seen.value), scene.table.game)
    made_by = why_chosen(detect, scene, still=True)
    return _sorted(StillBalls(seen.centre, seen.radius, kinds, seen.score, seen.sigma, made_by=made_by))


def _anywhere(rgb: ByteArray, detect: DetectOptions, note: str) -> StillBalls:
    seen = balls_anywhere(rgb, open_model(model_file(detect)))
    best = [int(np.argmax(look)) if np.nanmax(look, initial=0.0) > CLEAR_LOOK else -1 for look in seen.look]
    kinds = tuple("ball" if k < 0 else KIND_OF_LOOK[LOOKS[k]] for k in best)
    return _sorted(StillBalls(seen.centre, seen.radius, kinds, seen.score, np.maximum(seen.across, seen.along), note))


def _sorted(balls: StillBalls) -> StillBalls:
    order = np.lexsort((balls.centre[:, 1], balls.centre[:, 0]))
    kinds = tuple(balls.kind[k] for k in order)
    columns = (balls.radius[order], kinds, balls.score[order], balls.sigma[order])
    return StillBalls(balls.centre[order], *columns, balls.note, balls.made_by)
