"""A streak measured closer by a network that is shown it straightened: where the ball was, and its way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from detectors.network.streak_crop import Straight
from models.core.typing import ByteArray, FloatArray
from video.io.onnx_session import onnxruntime, opened_measuring

SCHEMA = "trueroll.streaks/1"
SHIPPED = Path(__file__).parent / "weights" / "streaks.onnx"
LOOKS = 2
"""How often a streak is looked at, the second time as the first one found it."""
LEAST_WAY_RADII = 0.35
"""Shorter ways are none: they have no direction to turn them by."""
MIRRORED = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [1, -1, 1, -1], [-1, -1, 1, 1]], dtype=np.float64)
"""Signs of what is told of a picture as it is, mirrored end to end, side to side, and both ways."""


@dataclass(frozen=True, slots=True)
class MeasuredStreak:
    """Where a streak is, px."""

    centre: FloatArray
    """(2,) of the ball at mid-exposure."""
    way: FloatArray
    """(2,) travelled during the exposure, sign unknown."""
    across: float
    along: float
    """Sigma of the centre."""


@dataclass(frozen=True, slots=True)
class StreakModel:
    """The network in an ONNX file."""

    session: onnxruntime.InferenceSession

    def measured(self, rgb: ByteArray, centre: FloatArray, radius: float, way: FloatArray) -> MeasuredStreak:
        """The streak of a ball of a radius, px, near a centre and a way (2,) px, in a picture (H, W, 3)."""
        at, sigma = Straight(centre, radius, way), np.zeros(4)
        for look in range(LOOKS):
            if look and np.linalg.norm(at.way) < LEAST_WAY_RADII * radius:
                break
            told, sigma = self.told(at.picture(rgb))
            at = at.moved(told)
        return MeasuredStreak(at.centre, at.way, radius * float(sigma[1]), radius * float(sigma[0]))

    def told(self, shown: ByteArray) -> tuple[FloatArray, FloatArray]:
        """What a straightened picture (ROWS, COLUMNS, 3) tells (4,), see `Straight.told`, and its sigmas (4,)."""
        forms = np.stack([shown, shown[:, ::-1], shown[::-1], shown[::-1, ::-1]])
        said = np.asarray(self.session.run(None, {"shown": forms})[0], dtype=np.float64)  # (4, 8)
        return (MIRRORED * said[:, :4]).mean(axis=0), np.exp(said[:, 4:]).mean(axis=0)


@lru_cache(maxsize=2)
def open_streak_model(path: Path = SHIPPED) -> StreakModel:
    """The network in an ONNX file; ModelError, one sentence, where it is none."""
    return StreakModel(opened_measuring(path, SCHEMA, "streaks"))
