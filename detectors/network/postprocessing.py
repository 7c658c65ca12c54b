"""Post-processing: which candidate detections of the ball network are balls, where they are, and how they move.

The network gives a rough position and a confidence score. Edges in the full image localise a ball more precisely where
they are clear; offset regressors do so where they are not, or where the ball moves. All errors are known, so a centre
is their weighted mean. A candidate that is not certain is a ball only if the image confirms it: by its outline
(`resting_balls`), or by the motion-blur model (`moving_balls`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.measurement.circle_fit import smooth_image
from detectors.measurement.cloth_background import ClothBackground
from detectors.measurement.frame_detections import FrameDetections, add_colours, is_inside_streaks
from detectors.measurement.overlap_resolution import resolve_overlaps
from detectors.measurement.working_view import WorkingView
from detectors.network.candidate_rules import CLEAR_SCORE, is_certain
from detectors.network.frame_context import FrameContext
from detectors.network.moving_balls import confirm_streaks, find_missed_streaks, measure_streaks
from detectors.network.offset_regressor import OffsetRegressor
from detectors.network.outline_fusion import MIN_SUPPORT
from detectors.network.peak_decoding import CandidateDetections
from detectors.network.resting_balls import RestingBalls, is_resting_ball, locate_resting_balls, refine_resting_balls
from models.core.array_columns import concatenate_rows
from models.core.detections import Detections
from models.core.typing import BoolArray, ByteArray, FloatArray


@dataclass(frozen=True, slots=True)
class PostProcessingResult:
    """Balls among the K candidates of a frame."""

    detections: Detections
    unclear: FloatArray
    """(n, 2) working px of the balls that only the network places."""
    is_rejected: BoolArray
    """(K,) candidates that the image shows to be no balls; only after a change there may they be checked again."""


@dataclass(frozen=True, slots=True)
class PostProcessor:
    """Makes detections of the candidates of a ball network."""

    view: WorkingView
    cloth: ClothBackground
    streak_regressor: OffsetRegressor
    disc_regressor: OffsetRegressor

    def process_candidates(self, rgb: ByteArray, candidates: CandidateDetections, frame: int) -> PostProcessingResult:
        """Select and measure the balls among candidates.

        Args:
            rgb: Image (H, W, 3) of the frame.
            candidates: K candidates, working px.
            frame: Number of the frame.

        Returns:
            The balls at rest and the streaks.
        """
        context = FrameContext(rgb, smooth_image(rgb), frame, self.view, self.cloth)
        certain = is_certain(candidates, self.view)
        measured, is_moving = measure_streaks(context, candidates, self.streak_regressor)
        rows = np.flatnonzero(~is_moving | ~certain)
        resting, may_move = locate_resting_balls(context, candidates.take(rows)), is_moving[rows]
        is_accepted = is_resting_ball(context, resting, may_move)
        is_rejected = np.zeros(len(candidates), dtype=bool)
        is_rejected[rows[~is_accepted & ~may_move]] = True
        resting = refine_resting_balls(context, resting.take(is_accepted), self.disc_regressor)
        missed, is_missed = find_missed_streaks(
            context, resting, measured.take(is_moving & certain), self.streak_regressor
        )
        at_rest = resting.detections.take(resting.has_clear_outline & ~is_missed)
        confirmed = confirm_streaks(context, measured.take(is_moving), certain[is_moving], at_rest)
        streaks = concatenate_rows([confirmed, missed])
        discs = resting.detections.take(~is_missed & ~_is_part_of_streak(resting, streaks))
        balls = resolve_overlaps(concatenate_rows([streaks, discs]), self.view.scene, frame)
        is_unclear = resting.outlines.support <= MIN_SUPPORT
        unclear = np.concatenate([candidates.centre[is_moving & certain], resting.candidates.centre[is_unclear]])
        return PostProcessingResult(add_colours(rgb, balls, frame), unclear, is_rejected)


def _is_part_of_streak(balls: RestingBalls, streaks: FrameDetections) -> BoolArray:
    """Which balls (N,) without a clear outline are within a streak with a higher score, and are not certain."""
    score = balls.detections.score
    is_covered = is_inside_streaks(balls.detections.centre, streaks) & (streaks.score[:, None] >= score)
    is_covered &= score < CLEAR_SCORE
    return np.asarray(is_covered.any(axis=0) & ~balls.has_clear_outline)
