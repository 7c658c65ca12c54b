"""Motion of a camera that turns and zooms about its place: from features of the background, and from painted lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
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
    ReferenceFeatures,
    detect_camera_motion,
    register_image,
)
from video.calibration.court_camera_fit import REFERENCE_WIDTH_PX, measure_places

# Cells of the image, along and down, that each give the same number of features: titles that are laid over the picture
# stand still, are sharp, and would else give most of them.
FEATURE_CELLS, FEATURES_PER_CELL = (10, 6), 3
# px of the image by which the background moves before another image becomes the one that features are tracked from.
MAX_TRACKING_SHIFT_PX = 80.0
# px, error of the places to which features move the image, and px across up to which paint is searched from there.
FEATURE_SIGMA_PX, LINE_REACH_PX = 1.0, 5.0
# px, error of a line's place in one frame: coding, blur of the motion.
LINE_SIGMA_PX = 0.3
# px from its predicted place beyond which paint is another line's, and least number of places that measure an error.
OUTLIER_PX, MIN_PLACES = 2.0, 10
FITTING_STEPS = 3
# Frames before the reference that are in memory at a time.
BACKWARD_FRAMES = 128
# See `estimate_court_motion`.
ReadImages = Callable[[int, int], Iterable[tuple[int, ByteArray]]]
# Weights of five neighbouring frames: those of a parabola's value at their middle.
SMOOTHING = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35


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
    sport: Sport, camera: CourtCamera, reference: int, read_images: ReadImages, count: int
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Follow a camera that turns and zooms about its place.

    Args:
        sport: the court.
        camera: the camera of the reference image.
        reference: number of the reference image.
        read_images: reads (number, grey image) of frames from a number to before another, in the order of time.
        count: number of frames T.

    Returns:
        Turns (T, 4) for `turn_camera`; (T,) whether each frame was measured, not interpolated in time; and (T,) px,
        root mean square distance of its lines, NaN where none are seen.
    """
    turns, errors = np.full((count, 4), np.nan), np.full(count, np.nan)
    trackers = [_Tracker(sport, camera, grey) for _, grey in read_images(reference, reference + 1) for _ in range(2)]
    for tracker in trackers[:1]:
        tracker.follow(read_images(reference, count), turns, errors)
    for tracker in trackers[1:]:
        for stop in range(reference, 0, -BACKWARD_FRAMES):
            block = list(read_images(max(stop - BACKWARD_FRAMES, 0), stop))
            tracker.follow(reversed(block), turns, errors)
    is_measured = np.isfinite(turns[:, 0])
    is_measured[reference] = True  # the reference does not turn, though nothing be seen to follow
    turns[reference] = np.where(np.isfinite(turns[reference]), turns[reference], 0.0)
    place = np.arange(count)
    turns = np.column_stack([np.interp(place, place[is_measured], column[is_measured]) for column in turns.T])
    return _smooth(turns, float(np.exp(camera.parameters[6]))), is_measured, errors


def compute_motion(camera: CourtCamera, turns: FloatArray) -> FloatArray:
    """Compute the homographies (T, 3, 3) of `CourtCamera.motion` from turns (T, 4)."""
    to_rays = np.linalg.inv(camera.matrix[:, :3])
    motion = np.stack([turn_camera(camera, turn).matrix[:, :3] @ to_rays for turn in turns])
    return np.asarray(motion / motion[:, 2:, 2:])


def combine_places(camera: CourtCamera, others: Sequence[CourtCamera]) -> tuple[CourtCamera, float]:
    """Improve a camera by other images' estimates of its place, which turning and zooming do not change.

    Returns:
        The camera, and the squared standardized difference of these places per number: about 1 where the camera stands.
    """
    weights = [np.linalg.inv(one.covariance[:3, :3]) for one in others]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    place = covariance @ np.sum([weight @ one.centre for weight, one in zip(weights, others, strict=True)], axis=0)
    own = camera.covariance[:, :3]
    gain = own @ np.linalg.inv(own[:3] + covariance)
    shift = place - camera.centre
    misfit = float(shift @ np.linalg.solve(own[:3] + covariance, shift))
    off = [one.centre - place for one in others]
    misfit += sum(float(one @ weight @ one) for one, weight in zip(off, weights, strict=True))
    misfit /= 3 * len(others)
    improved = camera.replace_parameters(camera.parameters + gain @ shift)
    shrunk = camera.covariance - gain @ own.T
    return replace(improved, covariance=(shrunk + shrunk.T) / 2 * max(1.0, misfit)), misfit


def turn_camera(camera: CourtCamera, turn: FloatArray) -> CourtCamera:
    """Turn a camera by a rotation vector (3) in its own axes, and scale its focal length by exp of a fourth number."""
    rotation = rotation_matrix(turn[:3]) @ rotation_matrix(camera.parameters[3:6])
    parameters = camera.parameters.copy()
    parameters[3:6] = cv2.Rodrigues(rotation)[0].ravel()
    parameters[6] += turn[3]
    return camera.replace_parameters(parameters)


class _Tracker:
    """Follows the background from image to image."""

    def __init__(self, sport: Sport, camera: CourtCamera, grey: ByteArray) -> None:
        self._sport, self._camera, self._previous = sport, camera, grey
        self._turn = np.zeros(4)
        self._set_key(grey)

    def _set_key(self, grey: ByteArray) -> None:
        self._key, self._key_turn = select_features(grey), self._turn
        self._guess: FloatArray | None = None

    def follow(self, images: Iterable[tuple[int, ByteArray]], turns: FloatArray, errors: FloatArray) -> None:
        """Measure turns (T, 4) and errors (T,), px, of images that follow the latest one."""
        for number, grey in images:
            registration = register_image(self._key, grey, self._guess)
            if registration is None or registration.share < MIN_INLIER_SHARE:
                # The last image that was measured resembles this one most.
                self._set_key(self._previous)
                registration = register_image(self._key, grey)
                if registration is None or registration.share < MIN_INLIER_SHARE:
                    continue
            self._turn, errors[number] = self._refine(registration.homography, grey)
            turns[number] = self._turn
            self._guess, self._previous = registration.homography, grey
            moved = apply_homography(registration.homography, self._key.corners) - self._key.corners
            if np.abs(moved).max() > MAX_TRACKING_SHIFT_PX * grey.shape[1] / REFERENCE_WIDTH_PX:
                self._set_key(grey)

    def _refine(self, homography: FloatArray, grey: ByteArray) -> tuple[FloatArray, float]:
        """Find the turn (4,) that agrees with a homography from the key image and with lines, and their error, px."""
        camera, sport = self._camera, self._sport
        size, scale = np.array([camera.width_px, camera.height_px]), camera.width_px / REFERENCE_WIDTH_PX
        share = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 4), np.linspace(0.1, 0.9, 3)), -1).reshape(-1, 1, 2)
        grid = np.broadcast_to(share * size, (len(share), 2, 2)).reshape(-1, 2)
        far = camera.centre + 10 * sport.length * turn_camera(camera, self._key_turn).rays(grid)
        target, across = apply_homography(homography, grid), np.tile(np.eye(2), (len(share), 1))
        sigma = np.full(len(grid), FEATURE_SIGMA_PX * scale)
        turn = _fit_turn(camera, self._turn, far, target, across, sigma)
        places = measure_places(grey.astype(np.float32), sport, turn_camera(camera, turn), LINE_REACH_PX * scale)
        good = np.isfinite(places.px[:, 0]) & (places.weight > 0) & (places.line < len(sport.lines))
        xyz, px, normal = places.xyz[good], places.px[good], places.normal[good]
        sigmas = np.concatenate([sigma, np.full(len(xyz), LINE_SIGMA_PX * scale)])
        turn = _fit_turn(
            camera, turn, np.concatenate([far, xyz]), np.concatenate([target, px]), np.concatenate([across, normal]),
            sigmas,
        )  # fmt: skip
        off = ((turn_camera(camera, turn).to_pixels(xyz) - px) * normal).sum(1)
        near = np.abs(off) < OUTLIER_PX * scale
        return turn, float(np.sqrt((off[near] ** 2).mean())) if near.sum() > MIN_PLACES else np.nan


def _fit_turn(
    camera: CourtCamera, turn: FloatArray, xyz: FloatArray, px: FloatArray, normal: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Fit the turn (4,) that shows places (K, 3) at pixels (K, 2), across normals (K, 2), with errors (K,), px."""
    for _ in range(FITTING_STEPS):
        turned = turn_camera(camera, turn)
        flip = np.array([1.0, -1.0 if camera.is_left_handed else 1.0, 1.0])
        x, y, z = rotation_matrix(turned.parameters[3:6]) @ ((xyz - camera.centre) * flip).T
        u, v, focal, one = x / z, y / z, np.exp(turned.parameters[6]), np.ones(len(x))
        # Pixels by small rotations about the axes of the camera and by the logarithm of the focal length.
        rates = focal * np.array([[-u * v, one + u**2, -v, u], [-one - v**2, u * v, u, v]])
        jacobian = (normal[:, 0] * rates[0] + normal[:, 1] * rates[1]).T / sigma[:, None]
        r = np.nan_to_num(((turned.to_pixels(xyz) - px) * normal).sum(1) / sigma, nan=1e3)
        weight = 1 / (1 + (r / 3) ** 2) ** 2
        step = np.linalg.solve((jacobian.T * weight) @ jacobian + 1e-9 * np.eye(4), (jacobian.T * weight) @ r)
        rotation = rotation_matrix(-step[:3]) @ rotation_matrix(turn[:3])
        turn = np.array([*cv2.Rodrigues(rotation)[0].ravel(), turn[3] - step[3]])
    return turn


def _smooth(turns: FloatArray, focal: float) -> FloatArray:
    """Smooth turns (T, 4) over a fifth of a second by parabolas (Savitzky and Golay 1964), but not sudden changes."""
    if len(turns) <= len(SMOOTHING):
        return turns
    margin = len(SMOOTHING) // 2
    before, after = 2 * turns[:1] - turns[margin:0:-1], 2 * turns[-1:] - turns[-2 : -2 - margin : -1]
    padded = np.concatenate([before, turns, after])
    smooth = np.column_stack([np.convolve(column, SMOOTHING, "valid") for column in padded.T])
    is_sudden = np.abs(smooth - turns).max(axis=1, keepdims=True) * focal > MAX_STILL_SHIFT_PX
    return np.where(is_sudden, turns, smooth)
