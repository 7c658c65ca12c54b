"""Exposure time, drift of the camera, and the moments at which balls are fast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.typing import BoolArray, ByteArray, FloatArray, ImageArray
from video.calibration.camera_motion import measure_shifts_of_images, register_image, select_reference_features

# Runs of consecutive frames in which balls are measured, and frames of each.
RUNS, RUN_FRAMES = 4, 3
# Grey levels by which a thumbnail pixel changes where something moves.
CHANGED_LEVELS = 14
# Share of the table that changes where a player or the camera moves, not a ball.
LARGE_SHARE = 0.03
# Ball radii that a resting ball seems to move from one frame to the next, and that a fast one moves at most.
STILL_RADII, REACH_RADII = 0.5, 14.0
# Ball radii that a ball moves where no streak shows a short exposure: detectors report streaks from a radius on.
SHARP_RADII = 3.0
# Largest ratio of the radii of one ball in two frames.
RADIUS_RATIO = 1.35
# Largest deviation of a streak from the direction of motion, share of its length.
SIDEWAYS_SHARE = 0.3
# Pairs of views of fast balls from which the exposure time is measured.
LEAST_PAIRS = 2
# Exposure time, share of the frame interval, above which a streak is not one of its ball.
LARGEST_SHARE = 1.1


def select_lively_runs(thumbnails: ImageArray, mask: BoolArray) -> list[list[int]]:
    """Select short runs of consecutive frames in which small things move fast on the table.

    Args:
        thumbnails: (K, h, w) small grey frames.
        mask: (h, w) of the playing surface.

    Returns:
        Indices of the frames of each run, in order of time.
    """
    frames = thumbnails[:, mask].astype(np.int16)
    changed = np.append((np.abs(np.diff(frames, axis=0)) > CHANGED_LEVELS).mean(axis=1), 0.0)
    liveliness = np.convolve(np.where(changed < LARGE_SHARE, changed, 0.0), np.ones(RUN_FRAMES - 1))[RUN_FRAMES - 2 :]
    liveliness[max(len(frames) - RUN_FRAMES + 1, 1) :] = -1.0
    runs: list[list[int]] = []
    for first in np.argsort(-liveliness, kind="stable").tolist():
        if all(abs(first - run[0]) >= RUN_FRAMES for run in runs):
            runs.append(list(range(first, min(first + RUN_FRAMES, len(frames)))))
        if len(runs) == RUNS:
            break
    return sorted(runs)


def measure_exposure_time(detections: Detections, t: FloatArray) -> float:
    """Measure the exposure time from the streaks of fast balls and their motion from frame to frame.

    Args:
        detections: Balls in some frames.
        t: (T,) s, time of every frame.

    Returns:
        Exposure time, ms; NaN where too few fast balls were seen in two consecutive frames.
    """
    times: list[float] = []
    for frame in np.unique(detections.frame):
        here, after = (np.flatnonzero(detections.frame == k) for k in (frame, frame + 1))
        times += _list_exposure_times(detections, here, after, t)
    return float(1e3 * np.median(times)) if len(times) >= LEAST_PAIRS else float("nan")


def _list_exposure_times(
    detections: Detections, here: NDArray[np.intp], after: NDArray[np.intp], t: FloatArray
) -> list[float]:
    """List the exposure times (s) of the balls that are fast between two frames."""
    times = []
    for one, other in _match_moving_balls(detections, here, after):
        shift, radius = detections.centre[other] - detections.centre[one], float(detections.radius[one])
        distance = float(np.hypot(*shift))
        first, second = (_streak_along(detections.streak[k], shift) for k in (one, other))
        is_sharp = first == second == 0 and distance > SHARP_RADII * radius
        share = (first + second) / (2 * distance)
        if (is_sharp or min(first, second) > 0) and share < LARGEST_SHARE:
            times.append(share * float(t[detections.frame[other]] - t[detections.frame[one]]))
    return times


def _match_moving_balls(
    detections: Detections, here: NDArray[np.intp], after: NDArray[np.intp]
) -> list[tuple[int, int]]:
    """Match the moving balls of two frames that are the nearest of each other, and equally large."""
    if not len(here) or not len(after):
        return []
    distance = np.linalg.norm(detections.centre[here][:, None] - detections.centre[after][None], axis=-1)
    radius = detections.radius[here][:, None]
    ratio = radius / detections.radius[after][None]
    distance[(ratio > RADIUS_RATIO) | (ratio < 1 / RADIUS_RATIO) | (distance > REACH_RADII * radius)] = np.inf
    nearest = distance.argmin(axis=1)
    return [
        (int(here[k]), int(after[n]))
        for k, n in enumerate(nearest)
        if distance[:, n].argmin() == k and STILL_RADII * float(radius[k, 0]) < distance[k, n] < np.inf
    ]


def _streak_along(streak: FloatArray, shift: FloatArray) -> float:
    """Return the length of a streak (px) along a motion; NaN where it points elsewhere, 0 for a sharp ball."""
    length = float(np.hypot(*streak))
    if length == 0:
        return 0.0
    direction = shift / np.hypot(*shift)
    sideways = abs(float(streak[0] * direction[1] - streak[1] * direction[0]))
    return length if sideways < SIDEWAYS_SHARE * length else float("nan")


def measure_drift(stills: Sequence[ByteArray], corners: FloatArray) -> float:
    """Measure how far the table moves in the image.

    Args:
        stills: Grey images (H, W).
        corners: (4, 2) px of the playing surface, or of any quadrangle around which there is detail.

    Returns:
        Largest motion against the first image, px, without the most deviating image; infinite where most images show
        another view, NaN where there is too little detail.
    """
    reference = select_reference_features(stills[0], corners)
    if register_image(reference, stills[0]) is None:
        return float("nan")
    shifts = measure_shifts_of_images(reference, stills[1:], 0.6)
    return float("inf") if shifts is None else shifts[-min(len(shifts), 2)]
