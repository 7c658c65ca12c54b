"""The network that judges spots: whether each is the object, and where exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from detectors.flying.frame_windows import FrameWindow
from detectors.flying.spot_patches import cut_patches
from models.core.typing import ByteArray, FloatArray, IntArray
from video.io.onnx_session import onnxruntime, open_measurement_session

SCHEMA = "trueroll-flying-3"
SHIPPED_SPOT_NETWORK = Path(__file__).parent / "weights" / "flying.onnx"
# Names of the network's input and output, and the columns of the latter. The streak is given by its length times the
# cosine and sine of twice its angle, which has no sign to be wrong.
INPUT_NAME, OUTPUT_NAME = "patches", "judgement"
COLUMNS = ("probability", "x", "y", "streak_cos", "streak_sin", "log_sigma", "log_sigma_along")


@dataclass(frozen=True, slots=True)
class SpotJudgement:
    """What the network says of K spots, in working px."""

    score: FloatArray
    """(K,) probability that the spot is the object."""
    centre: FloatArray
    """(K, 2)"""
    streak: FloatArray
    """(K, 2)"""
    sigma: FloatArray
    """(K, 2) across and along the streak."""


def judge_patches(session: onnxruntime.InferenceSession, patches: ByteArray, place: IntArray) -> SpotJudgement:
    """Judge patches (K, 16, 32, 32) about spots (K, 2)."""
    if not len(place):
        return SpotJudgement(np.empty(0), np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2)))
    outputs = np.asarray(session.run([OUTPUT_NAME], {INPUT_NAME: patches})[0], np.float64)
    return SpotJudgement(
        outputs[:, 0], place + outputs[:, 1:3], streak_from_double_angle(outputs[:, 3:5]), np.exp(outputs[:, 5:7])
    )


def judge_spots(window: FrameWindow, place: IntArray) -> SpotJudgement:
    """Judge spots (K, 2) of a frame by the shipped network."""
    return judge_patches(open_spot_network(SHIPPED_SPOT_NETWORK), cut_patches(window, place), place)


def streak_from_double_angle(doubled: FloatArray) -> FloatArray:
    """Turn lengths times cosine and sine of twice the angle (K, 2) into streaks (K, 2)."""
    length, angle = np.linalg.norm(doubled, axis=1), np.arctan2(doubled[:, 1], doubled[:, 0]) / 2
    return np.asarray(length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


@lru_cache(maxsize=2)
def open_spot_network(path: Path) -> onnxruntime.InferenceSession:
    """Open a network that judges spots.

    Raises:
        ModelError: The file cannot be read, or holds another kind of network.
    """
    return open_measurement_session(path, SCHEMA, "flying objects")
