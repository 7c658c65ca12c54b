"""Post-processing of candidates as balls at rest: their outlines decide whether they are balls, and where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from detectors.measurement.circle_fit import Circles
from detectors.measurement.frame_detections import FrameDetections
from detectors.measurement.working_view import values_at
from detectors.network.candidate_rules import (
    CLEAR_SCORE,
    REPORTED_SCORE,
    SIZE_LIMITS,
    FrameContext,
    is_certain,
    support_threshold,
)
from detectors.network.offset_regressor import OffsetRegressor
from detectors.network.outline_fusion import CLEAR_SUPPORT, locate_outlines, refine_doubtful_discs
from detectors.network.peak_decoding import CandidateDetections
from models.core.array_columns import replace_rows
from models.core.typing import BoolArray, IntArray

# Radius of a clear outline, over a ball's, below which it is that of a table spot: spots look like balls, but of 1,750
# balls, rendered and real, three in a thousand measure less than 0.86.
MIN_CLEAR_SIZE = 0.8
# Directions (6, 2) in which the centre of a ball may lie from a mark on it that the network detects as a small ball;
# the distance is the difference of the radii.
MARK_STARTS = np.array([[np.cos(angle), np.sin(angle)] for angle in np.arange(6) * np.pi / 3])


@dataclass(frozen=True, slots=True)
class RestingBalls:
    """N candidates measured as balls at rest."""

    candidates: CandidateDetections
    """Working px."""
    detections: FrameDetections
    """px of the frame."""
    outlines: Circles
    """px of the frame; support 0 where no outline fits."""

    def take(self, rows: IntArray | BoolArray) -> RestingBalls:
        """Select rows."""
        return RestingBalls(self.candidates.take(rows), self.detections.take(rows), self.outlines.take(rows))

    @property
    def has_clear_outline(self) -> BoolArray:
        """Which (N,) have a clear outline."""
        return np.asarray(self.outlines.support > CLEAR_SUPPORT)


def locate_resting_balls(context: FrameContext, candidates: CandidateDetections) -> RestingBalls:
    """Locate the outlines of candidates in working px; small ones are also tried as marks on a ball."""
    return _retry_around_marks(context, _locate_candidates(context, candidates))


def is_resting_ball(context: FrameContext, balls: RestingBalls, may_move: BoolArray) -> BoolArray:
    """Which (N,) are balls: certain ones that do not seem to move, and those with a sufficiently complete outline."""
    is_accepted = (is_certain(balls.candidates, context.view) & ~may_move) | (
        balls.outlines.support > support_threshold(balls.candidates)
    )
    return np.asarray(is_accepted & ~_is_table_spot(context, balls))


def refine_resting_balls(context: FrameContext, balls: RestingBalls, regressor: OffsetRegressor) -> RestingBalls:
    """Measure the balls whose outlines leave doubt with the regressor for balls at rest."""
    surroundings = context.surroundings_of(balls.candidates)
    refined = refine_doubtful_discs(
        context.rgb, context.smooth, balls.detections, balls.outlines, surroundings, regressor, context.frame
    )
    return replace(balls, detections=refined)


def _locate_candidates(context: FrameContext, candidates: CandidateDetections) -> RestingBalls:
    detections, outlines = locate_outlines(
        context.rgb, context.smooth, context.to_frame(candidates), context.surroundings_of(candidates), context.frame
    )
    # A candidate that only its outline makes a ball gets the least score that is reported.
    score = np.maximum(detections.score, REPORTED_SCORE)
    return RestingBalls(candidates, replace(detections, score=score), outlines)


def _is_table_spot(context: FrameContext, balls: RestingBalls) -> BoolArray:
    """Which (N,) have a clear outline that is too small for a ball."""
    is_small = balls.detections.radius < MIN_CLEAR_SIZE * context.ball_radius_at(balls.candidates)
    return np.asarray(balls.has_clear_outline & is_small)


def _retry_around_marks(context: FrameContext, balls: RestingBalls) -> RestingBalls:
    """Replace candidates that are too small for a ball by a complete outline around them, if there is one."""
    candidates = balls.candidates
    expected = values_at(context.view.radius, candidates.centre).astype(np.float64)
    is_small = (candidates.radius < SIZE_LIMITS[0] * expected) & (candidates.score > CLEAR_SCORE)
    marks = np.flatnonzero(is_small & (balls.outlines.support < support_threshold(candidates)))
    if not len(marks):
        return balls
    starts = candidates.take(np.repeat(marks, len(MARK_STARTS)))
    distance = np.repeat((expected - candidates.radius)[marks], len(MARK_STARTS))
    sigma = np.maximum(starts.sigma_across, distance)
    centre = starts.centre + distance[:, None] * np.tile(MARK_STARTS, (len(marks), 1))
    trials = _locate_candidates(context, replace(starts, centre=centre, sigma_across=sigma, sigma_along=sigma))
    support = trials.outlines.support
    best = support.reshape(len(marks), -1).argmax(axis=1) + np.arange(len(marks)) * len(MARK_STARTS)
    is_better = support[best] > balls.outlines.support[marks]
    best, marks = best[is_better], marks[is_better]
    return RestingBalls(
        candidates,
        replace_rows(balls.detections, marks, trials.detections.take(best)),
        replace_rows(balls.outlines, marks, trials.outlines.take(best)),
    )
