"""Balls at rest measured closer by a network that is shown each by itself, in one size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from detectors.network.disc_crop import Upright
from models.core.typing import ByteArray, FloatArray
from video.io.onnx_session import onnxruntime, opened_measuring

SCHEMA = "trueroll.discs/1"
SHIPPED = Path(__file__).parent / "weights" / "discs.onnx"
MOVED_RADII = 0.1
"""How far from where it was thought a ball is looked at once more, from where it was found."""
MIRRORED = np.array([-1.0, 1.0])
"""Signs of what is told of a picture mirrored side to side."""


@dataclass(frozen=True, slots=True)
class DiscModel:
    """The network in an ONNX file."""

    session: onnxruntime.InferenceSession

    def measured(self, rgb: ByteArray, centre: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centres (K, 2) px, and sigmas (K,), of balls of radii (K,) px near centres (K, 2), in a picture (H, W, 3)."""
        if not len(centre):
            return centre, radius
        place, sigma = self._look(rgb, centre, radius)
        again = np.flatnonzero(np.linalg.norm(place - centre, axis=1) > MOVED_RADII * radius)
        if len(again):
            place[again], sigma[again] = self._look(rgb, place[again], radius[again])
        return place, sigma

    def _look(self, rgb: ByteArray, centre: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same (K >= 1) by one look."""
        at = [Upright(place, float(size)) for place, size in zip(centre, radius, strict=True)]
        told, sigma = self.told(np.stack([ball.picture(rgb) for ball in at]))
        found = [ball.moved(word).centre for ball, word in zip(at, told, strict=True)]
        return np.array(found), radius * np.sqrt((sigma**2).mean(axis=1))

    def told(self, shown: ByteArray) -> tuple[FloatArray, FloatArray]:
        """What pictures (K, SIDE, SIDE, 3) tell (K, 2), see `Upright.told`, and its sigmas (K, 2)."""
        forms = np.concatenate([shown, shown[:, :, ::-1]])
        said = np.asarray(self.session.run(None, {"shown": forms})[0], dtype=np.float64).reshape(2, -1, 4)
        said[1, :, :2] *= MIRRORED
        return said[..., :2].mean(axis=0), np.exp(said[..., 2:]).mean(axis=0)


@lru_cache(maxsize=2)
def open_disc_model(path: Path = SHIPPED) -> DiscModel:
    """The network in an ONNX file; ModelError, one sentence, where it is none."""
    return DiscModel(opened_measuring(path, SCHEMA, "balls at rest"))
