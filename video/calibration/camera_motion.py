"""Motion of the camera: homographies from a reference image to every frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Camera, apply_homography
from models.core.typing import ByteArray, FloatArray
from video.calibration.camera_model import homography_between

# px: images are registered so that their longer side has about this length.
REGISTRATION_SIDE_PX = 640
# Ring that contains the features, in table lengths outside the noses: cushions, pockets, wood, diamonds.
RAIL_RANGE = (-0.012, 0.075)
# Largest number of tracked corner features.
MAX_FEATURES = 240
# Smallest number of features that must agree on a homography.
MIN_INLIERS = 12
# px of the original image by which features may appear to move for a fixed camera: noise, coding, heat.
MAX_STILL_SHIFT_PX = 0.8
# Smallest share of the tracked features that must agree; below it the image shows something else.
MIN_INLIER_SHARE = 0.4
# px, median distance of the located corners from their usual place up to which a camera stands on a stand: noise of the
# registration; the least motion in a hand is 1 px.
STILL_NOISE_PX = 0.4
# Multiple of that distance up to which the camera is at its usual place.
STILL_SIGMAS = 4.0
# Frames over which the motion of a camera is smoothed.
SMOOTHING_FRAMES = 5


@dataclass(frozen=True, slots=True)
class ReferenceFeatures:
    """An image and the features on its rails; images are reduced by `scale`."""

    grey: ByteArray
    points: NDArray[np.float32]
    """(N, 1, 2) px of the reduced image"""
    corners: FloatArray
    """(4, 2) px of the original image, corners of the noses"""
    scale: float


@dataclass(frozen=True, slots=True)
class Registration:
    """How an image is aligned with the reference."""

    homography: FloatArray
    """(3, 3) reference pixels to pixels of the image"""
    share: float
    """Share of the tracked features that agree on it"""
    residual: float
    """px of the original image, median error of these features"""
    shift: float
    """px of the original image, median motion of the features"""


def select_reference_features(grey: ByteArray, corners: FloatArray) -> ReferenceFeatures:
    """Select features on the rails around the noses.

    Args:
        grey: (H, W) the reference image.
        corners: (4, 2) px, corners of the noses in the order of `Table.corners`.

    Returns:
        The features, in an image reduced to `REGISTRATION_SIDE_PX`.
    """
    scale = min(1.0, REGISTRATION_SIDE_PX / max(grey.shape))
    small = _downscale_image(grey, scale)
    mask = _rail_mask(small.shape, (corners + 0.5) * scale - 0.5)
    points = cv2.goodFeaturesToTrack(small, MAX_FEATURES, 0.01, 5, mask=mask, blockSize=5)
    features = np.empty((0, 1, 2), np.float32) if points is None else points.reshape(-1, 1, 2).astype(np.float32)
    return ReferenceFeatures(small, features, corners, scale)


def register_image(
    reference: ReferenceFeatures, grey: ByteArray, guess: FloatArray | None = None
) -> Registration | None:
    """Track the reference features into an image and fit a homography.

    Args:
        reference: features of the reference image.
        grey: (H, W) the image.
        guess: (3, 3) homography that is nearly right, such as that of the previous frame.

    Returns:
        The registration; None where too few features agree.
    """
    small = _downscale_image(grey, reference.scale)
    start = reference.points
    if guess is not None:
        guessed = apply_homography(_rescale_homography(guess, reference.scale), reference.points.astype(np.float64))
        start = np.ascontiguousarray(guessed, np.float32)
    followed, is_tracked = _track_features(reference, small, start)
    if is_tracked.sum() < MIN_INLIERS:
        return None
    source, target = reference.points[is_tracked, 0], followed[is_tracked, 0]
    homography, inliers = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 1.0, maxIters=500)
    if homography is None or inliers.sum() < MIN_INLIERS:
        return None
    is_inlier = inliers[:, 0] > 0
    error = apply_homography(homography, source[is_inlier].astype(np.float64)) - target[is_inlier]
    residual = float(np.median(np.linalg.norm(error, axis=1))) / reference.scale
    shift = float(np.median(np.linalg.norm(target - source, axis=1))) / reference.scale
    share = float(is_inlier.sum() / is_tracked.sum())
    return Registration(_rescale_homography(homography, 1 / reference.scale), share, residual, shift)


def warp_camera(camera: Camera, homography: FloatArray) -> Camera:
    """Return the camera of an image that a homography aligns with the reference.

    Args:
        camera: Camera of the reference image.
        homography: (3, 3) reference pixels to pixels of the image.

    Returns:
        The camera of the image.
    """
    corners = apply_homography(homography, camera.corners_px)
    return replace(camera, matrix=homography @ camera.matrix, corners_px=corners)


def shift_camera(camera: Camera, shift: FloatArray) -> Camera:
    """Return the camera of an image that is shifted from the reference, as of a camera that drifts.

    Args:
        camera: Camera of the reference.
        shift: Shift (2,), px.

    Returns:
        The camera of the image.
    """
    move = np.eye(3)
    move[:2, 2] = shift
    return warp_camera(camera, move)


def _track_features(
    reference: ReferenceFeatures, small: ByteArray, start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Track features into another image: positions (N, 1, 2), and whether tracking back returns to the start."""
    if len(reference.points) == 0:
        return reference.points, np.zeros(0, np.bool_)
    forward, ok = _calculate_flow(reference.grey, small, reference.points, start)
    backward, ok_back = _calculate_flow(small, reference.grey, forward, reference.points)
    returns = np.linalg.norm((backward - reference.points)[:, 0], axis=1) < 0.5
    return forward, ok & ok_back & returns


def _calculate_flow(
    source: ByteArray, target: ByteArray, points: NDArray[np.float32], start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Lucas-Kanade: positions (N, 1, 2) in `target`, searched from `start`, and whether they were found."""
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    positions, ok, _ = cv2.calcOpticalFlowPyrLK(
        source, target, points, start.copy(), winSize=(15, 15), maxLevel=3, flags=flags
    )
    return np.asarray(positions, np.float32), np.asarray(ok[:, 0] > 0, np.bool_)


def detect_camera_motion(reference: ReferenceFeatures, images: list[ByteArray]) -> bool | None:
    """Decide whether the camera moves, from images spread over the clip.

    Args:
        reference: features of the reference image.
        images: grey images (H, W).

    Returns:
        True if the table shifts by more than `MAX_STILL_SHIFT_PX`; None where the images do not show the same view.
    """
    shifts = measure_shifts_of_images(reference, images, 0.7)
    return None if shifts is None else len(shifts) >= 2 and shifts[-2] > MAX_STILL_SHIFT_PX


def measure_shifts_of_images(
    reference: ReferenceFeatures, images: Sequence[ByteArray], least_share: float
) -> list[float] | None:
    """Measure how far images are shifted, px, the least first; None where fewer than a share can be registered."""
    registrations = [register_image(reference, image) for image in images]
    shifts = sorted(one.shift for one in registrations if one is not None and one.share > MIN_INLIER_SHARE)
    return None if len(shifts) < least_share * len(registrations) else shifts


def estimate_camera_motion(
    reference: ReferenceFeatures, images: Iterable[tuple[int, ByteArray]], count: int
) -> tuple[FloatArray, int]:
    """Estimate the motion of the camera in all frames.

    Args:
        reference: features of the reference image.
        images: (index, grey image) of the frames.
        count: number of frames T.

    Returns:
        Homographies (T, 3, 3) from the reference image to each frame, and the number of frames that could not be
        registered and were interpolated in time.
    """
    corners = np.full((count, 4, 2), np.nan)
    guess: FloatArray | None = None
    for frame, grey in images:
        registration = register_image(reference, grey, guess)
        if registration is None or registration.share < MIN_INLIER_SHARE:
            continue
        guess = registration.homography
        corners[frame] = apply_homography(registration.homography, reference.corners)
    is_registered = np.isfinite(corners[:, 0, 0])
    if not is_registered.any():
        return np.tile(np.eye(3), (count, 1, 1)), count
    frames = np.arange(count)
    flat = corners.reshape(count, 8)
    filled = np.column_stack([np.interp(frames, frames[is_registered], flat[is_registered, k]) for k in range(8)])
    if count >= SMOOTHING_FRAMES:
        # A hand moves smoothly over a fifth of a second; deviations from a parabola are registration noise.
        from scipy.signal import savgol_filter  # slow to import

        smooth = savgol_filter(filled, SMOOTHING_FRAMES, 2, axis=0)
        is_sudden = np.abs(smooth - filled).max(axis=1, keepdims=True) > MAX_STILL_SHIFT_PX
        filled = _hold_still(np.where(is_sudden, filled, smooth))
    smoothed = filled.reshape(count, 4, 2)
    return np.stack([homography_between(reference.corners, place) for place in smoothed]), int((~is_registered).sum())


def _hold_still(corners: FloatArray) -> FloatArray:
    """Give a camera on a stand one place in all frames (T, 8) in which it does not move beyond the noise.

    A camera that is knocked returns to its place and stays there for most of the clip; a hand never holds it still.
    """
    middle = np.median(corners, axis=0)
    distance = np.abs(corners - middle).max(axis=1)
    if np.median(distance) > STILL_NOISE_PX:
        return corners
    is_still = distance < STILL_SIGMAS * np.median(distance)
    return np.where(is_still[:, None], middle, corners)


def measure_shifts(corners: FloatArray, motion: FloatArray) -> FloatArray:
    """Measure how far the table is from its place in the reference image.

    Args:
        corners: (4, 2) px, corners of the table in the reference image.
        motion: (T, 3, 3) homographies from the reference image to each frame.

    Returns:
        (T,) px, median over the corners.
    """
    moved = apply_homography(motion[:, None], corners[None])
    return np.asarray(np.median(np.linalg.norm(moved - corners, axis=-1), axis=1), np.float64)


def _rail_mask(shape: tuple[int, ...], corners: FloatArray) -> NDArray[np.uint8]:
    """Mask (H, W) of the rails around corners (4, 2)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5]])
    outwards = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    to_image = homography_between(square, corners)
    mask = np.zeros(shape, np.uint8)
    for margin, value in ((RAIL_RANGE[1], 255), (RAIL_RANGE[0], 0)):
        outline = apply_homography(to_image, square + margin * outwards)
        cv2.fillConvexPoly(mask, np.rint(outline).astype(np.int32), value)
    return mask


def _downscale_image(grey: ByteArray, scale: float) -> ByteArray:
    if scale == 1.0:
        return grey
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _rescale_homography(homography: FloatArray, scale: float) -> FloatArray:
    """Convert a homography to images reduced by `scale`; pixel centres have integer coordinates in both."""
    shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1]])
    small = shrink @ homography @ np.linalg.inv(shrink)
    return np.asarray(small / small[2, 2], np.float64)
