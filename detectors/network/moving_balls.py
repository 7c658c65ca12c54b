"""Post-processing of candidates as motion-blur streaks: measurement, confirmation, and search for missed ones."""

from __future__ import annotations

import numpy as np

from detectors.measurement.frame_detections import NO_BALLS, FrameDetections, is_inside_streaks
from detectors.measurement.motion_blur import fit_motion_blur
from detectors.network.candidate_rules import CLEAR_SCORE, STREAK_RADII, FrameContext, is_certain
from detectors.network.offset_regressor import MIN_STREAK_RADII, OffsetRegressor, StreakMeasurement, measure_streak
from detectors.network.outline_fusion import CLEAR_SUPPORT
from detectors.network.peak_decoding import CandidateDetections
from detectors.network.resting_balls import RestingBalls
from models.core.array_columns import concatenate_rows
from models.core.typing import BoolArray

# Measured displacement, ball radii, from which a candidate is a streak: the outline of a ball that moved less is nearly
# a circle, which localises it better.
MIN_DISPLACEMENT_RADII = 0.5


def measure_streaks(
    context: FrameContext, candidates: CandidateDetections, regressor: OffsetRegressor
) -> tuple[FrameDetections, BoolArray]:
    """Measure the candidates that may be streaks.

    Args:
        context: The frame.
        candidates: K candidates in working px.
        regressor: Regressor of kind `STREAK`.

    Returns:
        All candidates in px of the frame, those that may be streaks as measured, and which (K,) move.
    """
    radius = context.ball_radius_at(candidates)
    streaks, is_moving = _candidates_to_streaks(context.to_frame(candidates)), np.zeros(len(candidates), dtype=bool)
    length = np.linalg.norm(candidates.streak, axis=1) / candidates.radius
    min_length = np.where(is_certain(candidates, context.view), MIN_STREAK_RADII, STREAK_RADII)
    for row in np.flatnonzero(length > min_length).tolist():
        measured = measure_streak(regressor, context.rgb, streaks.centre[row], float(radius[row]), streaks.streak[row])
        is_moving[row] = float(np.linalg.norm(measured.displacement)) > MIN_DISPLACEMENT_RADII * radius[row]
        streaks.centre[row], streaks.streak[row] = measured.centre, measured.displacement
        streaks.radius[row] = radius[row]
        streaks.sigma[row] = measured.sigma_across
        streaks.sigma_along[row] = max(measured.sigma_along, measured.sigma_across)
    return streaks, is_moving


def find_missed_streaks(
    context: FrameContext, balls: RestingBalls, streaks: FrameDetections, regressor: OffsetRegressor
) -> tuple[FrameDetections, BoolArray]:
    """Find streaks among balls without a clear outline by the motion-blur model.

    A streak over another ball that is certain is rejected: a row of balls adds up to a streak as well. So is one
    within a known streak: a ball in front of a streak is not the streak.

    Args:
        context: The frame.
        balls: N balls measured as balls at rest.
        streaks: Known streaks.
        regressor: Regressor of kind `STREAK`.

    Returns:
        The streaks, and which (N,) of the balls they replace.
    """
    radius = context.ball_radius_at(balls.candidates)
    is_moving, missed = np.zeros(len(radius), dtype=bool), NO_BALLS
    for row in np.flatnonzero(balls.outlines.support < CLEAR_SUPPORT).tolist():
        is_other = balls.has_clear_outline
        is_other[row] = False
        others, size = balls.detections.take(is_other), float(radius[row])
        fit = fit_motion_blur(
            context.rgb, balls.detections.centre[row], size, others.centre, others.radius, context.cloth.basis
        )
        if fit is None or not fit.is_streak(size):
            continue
        measured = measure_streak(regressor, context.rgb, fit.centre, size, fit.displacement)
        streak = _measurement_to_streak(measured, size, float(balls.detections.score[row]))
        is_known = is_inside_streaks(streak.centre, streaks).any()
        certain_centres = balls.detections.centre[_is_other_certain(balls.candidates, row)]
        if not is_known and not is_inside_streaks(certain_centres, streak).any():
            is_moving[row] = True
            missed = concatenate_rows([missed, streak])
    return missed, is_moving


def confirm_streaks(
    context: FrameContext, streaks: FrameDetections, certain: BoolArray, at_rest: FrameDetections
) -> FrameDetections:
    """Select the certain streaks and those that the motion-blur model confirms.

    Args:
        context: The frame.
        streaks: K measured streaks.
        certain: Mask (K,) of the certain ones.
        at_rest: Balls at rest, whose pixels are excluded.

    Returns:
        The selected streaks.
    """
    others = at_rest.take(np.asarray(~is_inside_streaks(at_rest.centre, streaks).any(axis=0)))
    is_confirmed = certain.copy()
    for row in np.flatnonzero(~certain).tolist():
        size = float(streaks.radius[row])
        fit = fit_motion_blur(
            context.rgb,
            streaks.centre[row],
            size,
            others.centre,
            others.radius,
            context.cloth.basis,
            streaks.streak[row],
        )
        is_confirmed[row] = fit is not None and fit.is_streak(size)
    return streaks.take(is_confirmed)


def _is_other_certain(candidates: CandidateDetections, row: int) -> BoolArray:
    """Which candidates (K,) other than one have a clear score."""
    is_other = candidates.score > CLEAR_SCORE
    is_other[row] = False
    return is_other


def _measurement_to_streak(measured: StreakMeasurement, radius: float, score: float) -> FrameDetections:
    """The streak of a ball of a radius, px, as a single row."""
    sigma_along = max(measured.sigma_along, measured.sigma_across)
    numbers = (np.array([number]) for number in (score, measured.sigma_across, sigma_along))
    return FrameDetections(measured.centre[None], np.array([radius]), measured.displacement[None], *numbers)


def _candidates_to_streaks(candidates: CandidateDetections) -> FrameDetections:
    """A copy of candidates in px of the frame."""
    sigma_along = np.maximum(candidates.sigma_along, candidates.sigma_across)
    columns = candidates.centre, candidates.radius, candidates.streak, candidates.score, candidates.sigma_across
    return FrameDetections(*(column.copy() for column in (*columns, sigma_along)))
