"""Exposure time, drift of the camera, and the moments at which balls are fast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.typing import BoolArray, ByteArray, FloatArray, ImageArray
from video.calibration.camera_motion import MIN_INLIER_SHARE, register_image, select_reference_features

RUNS, RUN_FRAMES = 4, 3
"""Runs of consecutive frames in which balls are measured, and frames of each."""
CHANGED_LEVELS = 14
"""Grey levels by which a thumbnail pixel changes where something moves."""
LARGE_SHARE = 0.03
"""Share of the table that changes where a player or the camera moves, not a ball."""
FAST_RADII, REACH_RADII = 1.2, 14.0
"""Ball radii that a fast ball moves from one frame to the next, and at most."""
RADIUS_RATIO = 1.35
"""Largest ratio of the radii of one ball in two frames."""
SIDEWAYS_SHARE = 0.3
"""Largest deviation of a streak from the direction of motion, share of its length."""
LEAST_PAIRS = 2
"""Pairs of views of fast balls from which the exposure time is measured."""
LARGEST_SHARE = 1.1
"""Exposure time, share of the frame interval, above which a streak is not one of its ball."""


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
    still = _find_still_balls(detections, here, after)
    here, after = here[~np.isin(here, still)], after[~np.isin(after, still)]
    for one in here:
        radius = detections.radius[one]
        matches = []
        for other in after:
            shift = detections.centre[other] - detections.centre[one]
            distance = float(np.hypot(*shift))
            ratio = detections.radius[other] / radius
            if FAST_RADII * radius < distance < REACH_RADII * radius and 1 / RADIUS_RATIO < ratio < RADIUS_RATIO:
                matches.append((float(np.linalg.norm(detections.colour[other] - detections.colour[one])), other, shift))
        if len(matches) != 1 and len(here) > 1:
            matches = sorted(matches, key=lambda match: match[0])[:1]
        for _, other, shift in matches[:1]:
            lengths = [_streak_along(detections.streak[k], shift) for k in (one, other)]
            share = float(np.mean(lengths)) / float(np.hypot(*shift))
            if np.isfinite(share) and share < LARGEST_SHARE:
                times.append(share * float(t[detections.frame[other]] - t[detections.frame[one]]))
    return times


def _find_still_balls(detections: Detections, here: NDArray[np.intp], after: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find the detections of two frames that lie at the same place in both."""
    if not len(here) or not len(after):
        return np.empty(0, dtype=np.intp)
    distance = np.linalg.norm(detections.centre[here][:, None] - detections.centre[after][None], axis=-1)
    near = distance < 0.5 * detections.radius[here][:, None]
    return np.concatenate([here[near.any(axis=1)], after[near.any(axis=0)]])


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
    registrations = [register_image(reference, image) for image in stills[1:]]
    shifts = sorted(one.shift for one in registrations if one is not None and one.share > MIN_INLIER_SHARE)
    if len(shifts) < 0.6 * len(registrations):
        return float("inf")
    return shifts[-2] if len(shifts) > 1 else shifts[-1]
