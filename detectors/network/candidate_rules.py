"""A frame whose candidate detections are checked, and the rules by which one is certain, may prove a ball, or moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.measurement.cloth_background import ClothBackground
from detectors.measurement.working_view import WorkingView, values_at
from detectors.network.outline_fusion import CLEAR_SUPPORT, WHOLE_SUPPORT, Surroundings
from detectors.network.peak_decoding import CandidateDetections
from models.core.typing import BoolArray, ByteArray, FloatArray


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


# Confidence score from which a ball is reported.
REPORTED_SCORE = 0.5
# Detected over predicted radius of a ball of this table; table spots are detected with 0.7.
SIZE_LIMITS = (0.76, 1.4)
# The same for a candidate that is a ball only if its outline is complete.
DOUBTFUL_SCORE, DOUBTFUL_SIZE_LIMITS = 0.25, (0.5, 1.6)
# The same for a moving candidate, which is a ball only if the motion-blur model explains the image. The network cannot
# localise the middle of a streak well, so that its confidence is shared among many cells.
FAINT_SCORE = 0.12
# Displacement during the exposure, ball radii, from which the network alone makes a streak of a ball.
STREAK_RADII = 1.0
# Confidence score from which there certainly is an object, possibly of the wrong size.
CLEAR_SCORE = 0.7


def is_certain(candidates: CandidateDetections, view: WorkingView) -> BoolArray:
    """Which candidates (K,) in working px are balls by the network alone."""
    return _is_within(candidates, view, REPORTED_SCORE, SIZE_LIMITS)


def is_possible(candidates: CandidateDetections, view: WorkingView) -> BoolArray:
    """Which candidates (K,) in working px are balls by the network alone, or may prove to be."""
    is_doubtful = _is_within(candidates, view, DOUBTFUL_SCORE, DOUBTFUL_SIZE_LIMITS)
    is_faint_streak = has_streak(candidates) & _is_within(candidates, view, FAINT_SCORE, DOUBTFUL_SIZE_LIMITS)
    return np.asarray(is_doubtful | is_faint_streak)


def has_streak(candidates: CandidateDetections) -> BoolArray:
    """Which candidates (K,) move by the network alone."""
    return np.asarray(np.linalg.norm(candidates.streak, axis=1) > STREAK_RADII * candidates.radius)


def support_threshold(candidates: CandidateDetections) -> FloatArray:
    """Support (K,) of the outline that makes a ball of a candidate that is not certain."""
    return np.where(candidates.score > CLEAR_SCORE, CLEAR_SUPPORT, WHOLE_SUPPORT)


def _is_within(
    candidates: CandidateDetections, view: WorkingView, score: float, size_limits: tuple[float, float]
) -> BoolArray:
    ratio = candidates.radius / values_at(view.radius, candidates.centre)
    return np.asarray((candidates.score > score) & (ratio > size_limits[0]) & (ratio < size_limits[1]))
