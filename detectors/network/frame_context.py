"""A frame whose candidate detections are checked, with the table and the cloth in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.measurement.cloth_background import ClothBackground
from detectors.measurement.working_view import WorkingView, values_at
from detectors.network.outline_fusion import Surroundings
from detectors.network.peak_decoding import CandidateDetections
from models.core.typing import ByteArray, FloatArray


@dataclass(frozen=True, slots=True)
class FrameContext:
    """A frame and the view of its table."""

    rgb: ByteArray
    """(H, W, 3)"""
    smooth: ByteArray
    """(H, W, 3) the same from `smooth_image`."""
    frame: int
    view: WorkingView
    cloth: ClothBackground

    def ball_radius_at(self, candidates: CandidateDetections) -> FloatArray:
        """Radius (K,) of a ball of this table at candidates in working px, px of the frame."""
        return np.asarray(values_at(self.view.radius, candidates.centre).astype(np.float64) / self.view.scale)

    def to_frame(self, candidates: CandidateDetections) -> CandidateDetections:
        """Candidates in working px, in px of the frame."""
        return candidates.transform(lambda px: self.view.working_to_frame(px, self.frame), 1 / self.view.scale)

    def surroundings_of(self, candidates: CandidateDetections) -> Surroundings:
        """The surroundings in which the outlines of candidates in working px are located."""
        cloth_colour = np.asarray(values_at(self.cloth.colour, candidates.centre), dtype=np.float64)
        return Surroundings(self.ball_radius_at(candidates), cloth_colour, self.cloth.basis, self.view.scene)
