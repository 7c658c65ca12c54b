"""Estimation of the shutter time from the length of the streaks in the frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import Float32Array, FloatArray, ImageArray
from video.io.clip import Clip
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import BallOutline, matte_balls, sample_path
from video.matting.ball_timeline import BallTimeline, read_rows
from video.matting.compositing import SpriteLayer, composite_balls
from video.matting.sharp_balls import (
    FAST_RADII,
    SharpBalls,
    find_isolated_rows,
    frame_to_frame_shifts,
    match_brightness,
)

# Candidate shutter times as shares of the frame interval.
SHUTTER_SHARES = np.array([0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3, 0.4, 0.5, 0.7, 0.9])
# Views that are evaluated, the fastest ones.
MAX_VIEWS = 10
# Views below which the shutter time stays as it was.
MIN_VIEWS = 2
# Largest error of a streak relative to a sharp ball: balls that rotate, or are in another light, fit a little better
# when blurred (0.5 to 0.8 on clips with a short shutter time; 0.25 on one with a long one).
MAX_ERROR_SHARE = 0.4
# Radii of streak from which a larger error share suffices, and that share: a sharp ball blurred so far fits worse.
LONG_STREAK_RADII, MAX_ERROR_SHARE_LONG = 1.0, 0.75
# Radii of isotropic blur that coding may add to a moving ball, besides none: such blur is no streak.
SOFT_RADII = (0.05, 0.1, 0.2)
# Resolution of the shutter share.
FINE_STEPS = 181
# Multiple of the typical least error from which a view shows another object, such as a hand or a wrong ball.
MAX_RELATIVE_ERROR = 3.0


def estimate_shutter_time(
    timeline: BallTimeline, clip: Clip, plate: BackgroundPlate, balls: SharpBalls
) -> BallTimeline:
    """Estimate the shutter time that makes the sharp balls most similar to the fast ones.

    Args:
        timeline: Positions of the balls.
        plate: Background plate.
        balls: Sharp views of the balls.

    Returns:
        The timeline with the shutter time and its streak paths; unchanged where the streaks are inconclusive.
    """
    fastest_views = find_fastest_views(timeline, balls.views)
    step = float(np.median(np.diff(timeline.t))) if len(timeline.t) > 1 else 0.0
    measured = [
        (_compute_streak_errors(timeline, plate, balls, row, ball, image, step), speed)
        for row, image in read_rows(clip, timeline, (row for _, row, _ in fastest_views))
        for speed, other, ball in fastest_views
        if other == row
    ]
    errors = [(*pair, speed) for pair, speed in measured if pair is not None]
    share = estimate_shutter_share(errors) if len(errors) >= MIN_VIEWS else 0.0
    if share == 0:
        return timeline
    shutter_time = share * step
    return replace(timeline, shutter_time=shutter_time, streak_path=timeline.streak_paths(timeline.t, shutter_time))


def estimate_shutter_share(errors: list[tuple[FloatArray, FloatArray, float]]) -> float:
    """Return the shutter time as a share of the frame interval; 0 where the streaks are inconclusive.

    Each view gives the errors (S,) for each of `SHUTTER_SHARES`, the errors (S,) of a ball that coding may have
    softened,
    and the radii of motion between two frames.
    """
    typical = np.median([crisp.min() for crisp, _, _ in errors])
    used = [one for one in errors if one[0].min() <= MAX_RELATIVE_ERROR * typical]
    total = np.sum([crisp for crisp, _, _ in used], axis=0)
    streak = SHUTTER_SHARES[int(np.argmin(total))] * float(np.median([speed for *_, speed in used]))
    if total.min() > (MAX_ERROR_SHARE_LONG if streak > LONG_STREAK_RADII else MAX_ERROR_SHARE) * total[0]:
        return 0.0
    return _shortest_adequate_share(np.array([soft for _, soft, _ in used]))


def find_fastest_views(timeline: BallTimeline, balls: Iterable[int]) -> list[tuple[float, int, int]]:
    """Select the fastest isolated views of some balls.

    Args:
        timeline: Positions of the balls.
        balls: Indices of the balls.

    Returns:
        (radii of motion per frame, row, ball), the fastest first.
    """
    speed = frame_to_frame_shifts(timeline) / timeline.radius
    views = [(float(speed[row, ball]), int(row), ball) for ball in balls for row in find_isolated_rows(timeline, ball)]
    return sorted((entry for entry in views if entry[0] > FAST_RADII), reverse=True)[:MAX_VIEWS]


def _compute_streak_errors(
    timeline: BallTimeline,
    plate: BackgroundPlate,
    balls: SharpBalls,
    row: int,
    ball: int,
    image: ImageArray,
    step: float,
) -> tuple[FloatArray, FloatArray] | None:
    """Return squared errors (S,) around a ball rendered with each of `SHUTTER_SHARES`, without and with softening.

    None where the ball has no usable view.
    """
    t, radius = float(timeline.t[row]), float(timeline.radius[row, ball])
    paths = timeline.streak_paths(np.full(len(SHUTTER_SHARES), t), SHUTTER_SHARES * step)[:, :, ball]
    if not np.isfinite(paths[-1]).all():
        return None
    centre = timeline.centre[row, ball]
    wide = BallOutline(centre + paths[-1], centre, radius)
    matted = matte_balls(image, [wide], [], plate, timeline.camera_motion_at(t))
    unblurred = matte_balls(
        image, [BallOutline(centre[None], centre, radius)], [], plate, timeline.camera_motion_at(t)
    ).sprites[0]
    elsewhere = balls.select_sharpest(ball, t, radius, ())
    if elsewhere is None or unblurred is None:
        return None
    sharp = match_brightness(elsewhere, unblurred)
    x0, y0 = np.maximum(wide.path.min(axis=0) - 1.5 * radius, 0).astype(int)
    x1, y1 = (wide.path.max(axis=0) + 1.5 * radius + 1).astype(int)
    here = np.s_[y0:y1, x0:x1]
    empty, errors, rendered = matted.background[here].astype(np.float32), [], matted.background.copy()
    for path in paths:
        changed = composite_balls(rendered, [[SpriteLayer(sharp, centre + sample_path(path), 1.0)]])
        errors.append(_streak_misfit(rendered[here] - empty, image[here] - empty, radius))
        for left, top, right, bottom in changed:
            rendered[top:bottom, left:right] = matted.background[top:bottom, left:right]
    crisp, soft = np.array(errors).T
    return crisp, soft


def _streak_misfit(rendered: Float32Array, observed: Float32Array, radius: float) -> tuple[float, float]:
    """Return the mean squared error of a ball's contribution (h, w, 3) to the table, and the least when softened."""
    variants = [rendered, *(cv2.GaussianBlur(rendered, (0, 0), share * radius) for share in SOFT_RADII)]
    errors = [float(((variant - observed) ** 2).mean()) for variant in variants]
    return errors[0], min(errors)


def _shortest_adequate_share(errors: FloatArray) -> float:
    """Return the shortest share that explains the views (n, S) as well as the best one, within one standard error.

    A streak that is too long shows a ball where it never was; one that is too short is only crisper (the
    one-standard-error
    rule of Breiman, Friedman, Olshen and Stone 1984).
    """
    fine = np.linspace(0, SHUTTER_SHARES[-1], FINE_STEPS)
    curves = CubicSpline(SHUTTER_SHARES, errors / errors.min(axis=1, keepdims=True), axis=1)(fine)
    worse = curves - curves[:, [int(np.argmin(curves.mean(axis=0)))]]
    standard_error = worse.std(axis=0, ddof=1) / np.sqrt(len(errors)) if len(errors) > 1 else np.zeros(FINE_STEPS)
    return float(fine[int(np.argmax(worse.mean(axis=0) <= standard_error))])
