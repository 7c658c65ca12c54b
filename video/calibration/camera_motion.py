"""A camera that moves: where the table of a reference picture is in every other picture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import ByteArray, FloatArray
from video.calibration.camera_model import homography_between

TRACK_WIDTH = 640
"""px: pictures are registered at about this width."""
RAIL = (-0.012, 0.075)
"""Ring in which features are taken, in table lengths outside the noses: cushions, pockets, wood, diamonds."""
FEATURES = 240
"""At most this many corners are followed."""
LEAST_INLIERS = 12
"""Fewer features that agree do not fix a homography."""
STILL = 0.8
"""px of the original picture by which features may seem to move while the camera stands: noise, coding, heat."""
LEAST_SHARE = 0.4
"""Share of the followed features that must agree, or the picture shows something else."""
SMOOTHING = 5
"""Pictures over which a moving camera is smoothed."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A picture with features on its rails; pictures are reduced by `scale`."""

    grey: ByteArray
    points: NDArray[np.float32]
    """(N, 1, 2) px of the reduced picture"""
    corners: FloatArray
    """(4, 2) px of the original picture"""
    scale: float


@dataclass(frozen=True, slots=True)
class Registration:
    """How a picture lies against the reference."""

    homography: FloatArray
    """(3, 3) reference pixels to the picture's"""
    inliers: int
    """Features that agree on it"""
    share: float
    """Their share of those that could be followed"""
    residual: float
    """px, median miss of the inliers in the original picture"""
    shift: float
    """px, median way of the features in the original picture"""


def reference_of(grey: ByteArray, corners: FloatArray) -> Reference:
    """Choose features on the rails around noses at corners (4, 2) px, `Table.corners` order, of a grey picture."""
    scale = min(1.0, TRACK_WIDTH / grey.shape[1])
    small = _reduced(grey, scale)
    mask = _ring(small.shape, (corners + 0.5) * scale - 0.5)
    points = cv2.goodFeaturesToTrack(small, FEATURES, 0.01, 5, mask=mask, blockSize=5)
    found = np.empty((0, 1, 2), np.float32) if points is None else points.reshape(-1, 1, 2).astype(np.float32)
    return Reference(small, found, corners, scale)


def register(reference: Reference, grey: ByteArray, guess: FloatArray | None = None) -> Registration | None:
    """Follow the reference's features into a picture; None where too few agree.

    `guess` (3, 3) is a homography that is nearly right, such as that of the picture before.
    """
    small = _reduced(grey, reference.scale)
    start = reference.points
    if guess is not None:
        guessed = apply_homography(_to_small(guess, reference.scale), reference.points.astype(np.float64))
        start = np.ascontiguousarray(guessed, np.float32)
    followed, kept = _follow(reference, small, start)
    if kept.sum() < LEAST_INLIERS:
        return None
    source, target = reference.points[kept, 0], followed[kept, 0]
    homography, inliers = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 1.0, maxIters=500)
    if homography is None or inliers.sum() < LEAST_INLIERS:
        return None
    agree = inliers[:, 0] > 0
    miss = apply_homography(homography, source[agree].astype(np.float64)) - target[agree]
    residual = float(np.median(np.linalg.norm(miss, axis=1))) / reference.scale
    shift = float(np.median(np.linalg.norm(target - source, axis=1))) / reference.scale
    share = float(agree.sum() / kept.sum())
    return Registration(_to_small(homography, 1 / reference.scale), int(agree.sum()), share, residual, shift)


def _follow(
    reference: Reference, small: ByteArray, start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Places (N, 1, 2) of the features in another picture, and whether following them back leads home."""
    if len(reference.points) == 0:
        return reference.points, np.zeros(0, np.bool_)
    there, ok = _flow(reference.grey, small, reference.points, start)
    back, ok_back = _flow(small, reference.grey, there, reference.points)
    home = np.linalg.norm((back - reference.points)[:, 0], axis=1) < 0.5
    return there, ok & ok_back & home


def _flow(
    source: ByteArray, target: ByteArray, points: NDArray[np.float32], start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Lucas-Kanade: places (N, 1, 2) in `target`, searched from `start`, and whether they were found."""
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    places, ok, _ = cv2.calcOpticalFlowPyrLK(
        source, target, points, start.copy(), winSize=(15, 15), maxLevel=3, flags=flags
    )
    return np.asarray(places, np.float32), np.asarray(ok[:, 0] > 0, np.bool_)


def camera_moves(reference: Reference, pictures: list[ByteArray]) -> bool | None:
    """Whether the table moves in the picture by more than `STILL`; None where pictures do not show the same view."""
    found = [register(reference, picture) for picture in pictures]
    good = [one for one in found if one is not None and one.share > LEAST_SHARE]
    if len(good) < 0.7 * len(found):
        return None
    shifts = sorted(one.shift for one in good)
    # One picture may mislead: an overlay that slides in, a player who leans on the rail.
    return len(shifts) >= 2 and shifts[-2] > STILL


def follow_camera(
    reference: Reference, pictures: Iterable[tuple[int, ByteArray]], count: int
) -> tuple[FloatArray, int]:
    """Homographies (T, 3, 3) reference to picture, and how many pictures could not be registered.

    What could not be is interpolated between its neighbours in time.
    """
    corners = np.full((count, 4, 2), np.nan)
    guess: FloatArray | None = None
    for frame, grey in pictures:
        found = register(reference, grey, guess)
        if found is None or found.share < LEAST_SHARE:
            continue
        guess = found.homography
        corners[frame] = apply_homography(found.homography, reference.corners)
    known = np.isfinite(corners[:, 0, 0])
    if not known.any():
        return np.tile(np.eye(3), (count, 1, 1)), count
    frames = np.arange(count)
    flat = corners.reshape(count, 8)
    filled = np.column_stack([np.interp(frames, frames[known], flat[known, k]) for k in range(8)])
    if count >= SMOOTHING:
        # A hand moves smoothly over a fifth of a second; what is left of a parabola is noise of the registration.
        from scipy.signal import savgol_filter  # slow to import, and every start of the program would wait

        filled = savgol_filter(filled, SMOOTHING, 2, axis=0)
    moved = filled.reshape(count, 4, 2)
    return np.stack([homography_between(reference.corners, place) for place in moved]), int((~known).sum())


def _ring(shape: tuple[int, ...], corners: FloatArray) -> NDArray[np.uint8]:
    """Mask of the rails around corners (4, 2)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5]])
    away = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    to_picture = homography_between(square, corners)
    mask = np.zeros(shape, np.uint8)
    for margin, value in ((RAIL[1], 255), (RAIL[0], 0)):
        outline = apply_homography(to_picture, square + margin * away)
        cv2.fillConvexPoly(mask, np.rint(outline).astype(np.int32), value)
    return mask


def _reduced(grey: ByteArray, scale: float) -> ByteArray:
    if scale == 1.0:
        return grey
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _to_small(homography: FloatArray, scale: float) -> FloatArray:
    """The same motion between pictures reduced by `scale`; pixel centres are whole numbers in both."""
    shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1]])
    small = shrink @ homography @ np.linalg.inv(shrink)
    return np.asarray(small / small[2, 2], np.float64)
