"""Motion of a camera that turns and zooms about its place: from features of the background, and from painted lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.court_camera import CourtCamera, rotation_matrix
from models.core.scene import apply_homography
from models.core.typing import ByteArray, FloatArray
from video.calibration.camera_motion import (
    MAX_STILL_SHIFT_PX,
    MIN_INLIER_SHARE,
    REGISTRATION_SIDE_PX,
    SMOOTHING_FRAMES,
    ReferenceFeatures,
    detect_camera_motion,
    register_image,
)
from video.calibration.court_camera_fit import REFERENCE_WIDTH_PX, measure_places

# Cells of the image, along and down, that each give the same number of features: titles that are laid over the picture
# stand still, are sharp, and would else give most of them.
FEATURE_CELLS, FEATURES_PER_CELL = (10, 6), 5
# px of the image by which the background moves before another image becomes the one that features are tracked from.
MAX_TRACKING_SHIFT_PX = 80.0
# px, error of the places to which features move the image, and px across up to which paint is searched from there.
FEATURE_SIGMA_PX, LINE_REACH_PX = 1.0, 5.0
# px, error of a line's place in one frame: coding, blur of the motion.
LINE_SIGMA_PX = 0.3
REFINEMENT_STEPS = 3


def select_features(grey: ByteArray) -> ReferenceFeatures:
    """Select features all over an image (H, W), as many in each part of it."""
    scale = min(1.0, REGISTRATION_SIDE_PX / max(grey.shape))
    small = grey if scale == 1 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    height, width = small.shape
    columns, rows = FEATURE_CELLS
    points = [np.empty((0, 1, 2), np.float32)]
    for k in range(columns * rows):
        left, top = k % columns * width // columns, k // columns * height // rows
        cell = small[top : top + height // rows, left : left + width // columns]
        some = cv2.goodFeaturesToTrack(cell, FEATURES_PER_CELL, 0.05, 5, blockSize=5)
        if some is not None:
            points.append(some.reshape(-1, 1, 2) + np.array([left, top], np.float32))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(grey.shape[::-1]) - 1.0)
    return ReferenceFeatures(np.asarray(small, np.uint8), np.concatenate(points).astype(np.float32), corners, scale)


def stands_still(greys: list[ByteArray]) -> bool:
    """Decide whether a camera stands, from grey images (H, W) spread over a clip."""
    moves = detect_camera_motion(select_features(greys[0]), greys[1:])
    return moves is not None and not moves


def estimate_court_motion(
    sport: Sport, camera: CourtCamera, reference: int, images: Iterable[tuple[int, ByteArray]], count: int
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Follow a camera that turns and zooms about its place.

    Args:
        sport: the court.
        camera: the camera of the reference image.
        reference: number of the reference image.
        images: (number, grey image) of frames in the order of time.
        count: number of frames T.

    Returns:
        Homographies (T, 3, 3) from the reference image to each frame, both without distortion; (T,) whether each frame
        was measured, not interpolated in time; and (T,) px, root mean square distance of its lines, NaN where none are.
    """
    frames = dict(images)
    turns, errors = np.full((count, 4), np.nan), np.full(count, np.nan)
    numbers = sorted(frames)
    for way in ([n for n in numbers if n >= reference], [n for n in reversed(numbers) if n <= reference]):
        _follow(sport, camera, [(n, frames[n]) for n in way], turns, errors)
    is_measured = np.isfinite(turns[:, 0])
    place = np.arange(count)
    turns = np.column_stack([np.interp(place, place[is_measured], column[is_measured]) for column in turns.T])
    turns = _smooth(turns, camera)
    start = camera.matrix[:, :3]
    motion = np.stack([turn_camera(camera, turn).matrix[:, :3] @ np.linalg.inv(start) for turn in turns])
    return motion / motion[:, 2:, 2:], is_measured, errors


def turn_camera(camera: CourtCamera, turn: FloatArray) -> CourtCamera:
    """Turn a camera by a rotation vector (3) in its own axes, and multiply its focal length by exp of a fourth number."""
    rotation = rotation_matrix(turn[:3]) @ rotation_matrix(camera.parameters[3:6])
    parameters = camera.parameters.copy()
    parameters[3:6] = cv2.Rodrigues(rotation)[0].ravel()
    parameters[6] += turn[3]
    return camera.replace_parameters(parameters)


def _follow(
    sport: Sport, camera: CourtCamera, images: list[tuple[int, ByteArray]], turns: FloatArray, errors: FloatArray
) -> None:
    """Measure turns (T, 4) of images that follow each other from the reference image, which comes first."""
    key, key_turn = select_features(images[0][1]), np.zeros(4)
    guess: FloatArray | None = None
    turn, previous = np.zeros(4), images[0][1]
    for number, grey in images:
        found = register_image(key, grey, guess)
        if found is None or found.share < MIN_INLIER_SHARE:
            # The last image that was measured resembles this one most.
            key, key_turn, guess = select_features(previous), turn, None
            found = register_image(key, grey)
            if found is None or found.share < MIN_INLIER_SHARE:
                continue
        turn, error = _refine(sport, camera, key_turn, found.homography, turn, grey)
        turns[number], errors[number] = turn, error
        guess, previous = found.homography, grey
        moved = apply_homography(found.homography, key.corners) - key.corners
        if np.abs(moved).max() > MAX_TRACKING_SHIFT_PX * grey.shape[1] / REFERENCE_WIDTH_PX:
            key, key_turn, guess = select_features(grey), turn, None


def _refine(
    sport: Sport, camera: CourtCamera, key_turn: FloatArray, homography: FloatArray, turn: FloatArray, grey: ByteArray
) -> tuple[FloatArray, float]:
    """Find the turn (4,) that agrees with a homography from the key image and with the lines, and their error, px."""
    width, height = camera.width_px, camera.height_px
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 4) * width, np.linspace(0.1, 0.9, 3) * height), -1).reshape(-1, 2)
    key = turn_camera(camera, key_turn)
    far, target = camera.centre + 10 * sport.length * key.rays(grid), apply_homography(homography, grid)
    scale = width / REFERENCE_WIDTH_PX
    xyz, seen, normal = np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2))
    brightness = grey.astype(np.float32)
    spread = np.nan

    def residuals(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        turned = turn_camera(camera, at)
        off = (turned.to_pixels(far) - target).ravel() / (FEATURE_SIGMA_PX * scale)
        line = ((turned.to_pixels(xyz) - seen) * normal).sum(1) / (LINE_SIGMA_PX * scale)
        return np.nan_to_num(off, nan=1e3), line

    for step in range(REFINEMENT_STEPS):
        if step:
            places = measure_places(brightness, sport, turn_camera(camera, turn), LINE_REACH_PX * scale)
            good = np.isfinite(places.px[:, 0]) & (places.weight > 0) & (places.line < len(sport.lines))
            xyz, seen, normal = places.xyz[good], places.px[good], places.normal[good]
        for _ in range(2):
            off, line = residuals(turn)
            weight = np.concatenate([1 / (1 + (off / 3) ** 2), 1 / (1 + (line / 3) ** 2) ** 2])
            r = np.concatenate([off, line])
            nudges = 1e-5 * np.eye(4)
            jacobian = np.column_stack([(np.concatenate(residuals(turn + nudge)) - r) / 1e-5 for nudge in nudges])
            turn = turn - np.linalg.solve((jacobian.T * weight) @ jacobian + 1e-9 * np.eye(4), (jacobian.T * weight) @ r)
    line = residuals(turn)[1] * LINE_SIGMA_PX * scale
    near = np.abs(line) < 2 * scale
    if near.sum() > 10:
        spread = float(np.sqrt((line[near] ** 2).mean()))
    return turn, spread


def _smooth(turns: FloatArray, camera: CourtCamera) -> FloatArray:
    """Smooth turns (T, 4) over a fifth of a second, but where they change suddenly."""
    if len(turns) < SMOOTHING_FRAMES:
        return turns
    from scipy.signal import savgol_filter  # slow to import

    smooth = savgol_filter(turns, SMOOTHING_FRAMES, 2, axis=0)
    to_px = np.exp(camera.parameters[6]) * np.array([1, 1, 1, 1.0])
    is_sudden = (np.abs(smooth - turns) * to_px).max(axis=1, keepdims=True) > MAX_STILL_SHIFT_PX
    return np.where(is_sudden, turns, smooth)


def moves_with(camera: CourtCamera, motion: FloatArray, first_frame: int) -> CourtCamera:
    """Return a camera with its motion (T, 3, 3)."""
    return replace(camera, motion=motion, first_frame=first_frame)
