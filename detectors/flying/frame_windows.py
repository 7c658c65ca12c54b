"""Frames beside their neighbours in time, aligned where the camera turns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court_camera import CourtCamera
from models.core.scene import apply_homography
from models.core.typing import ByteArray, FloatArray
from video.io.clip import Clip, read_planes

# s from a frame to its neighbours, about: at higher frame rates a slow object would cover its own place.
NEIGHBOUR_S = 1 / 30
# s to its far neighbours: at the top of its arc an object falls by 14 cm in it, more than the size of any.
FAR_S = 1 / 6
# Images of a window: of the frame, its two neighbours and its far neighbour on either side.
WINDOW, MIDDLE_IMAGE = 7, 3
# Those that are moved onto the frame where the camera moves.
ALIGNED = (0, 2, 4, 6)
# px by which the camera may move between neighbours without being followed: less than coding moves edges.
STILL_PX = 0.1


# From px to those of images of half the size.
TO_HALF = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])


@dataclass(frozen=True, slots=True)
class PlaneImage:
    """An image in working px, by its planes."""

    luma: ByteArray
    """(H, W)"""
    chroma: ByteArray
    """(H/2, W/2, 2) blue and red differences, neutral at 128."""


@dataclass(frozen=True, slots=True)
class FrameWindow:
    """A frame, its neighbours at steps of about `NEIGHBOUR_S`, and its far neighbours."""

    frame: int
    """Index in the file."""
    images: tuple[PlaneImage, ...]
    """Seven, in the order of time; at the ends of a view, neighbours of the other side replace missing ones.
    The nearest and the far ones show the places of the fourth, the frame itself.
    """
    shifts: FloatArray
    """(7, 3, 3) homographies from px of the frame to those of each image."""
    is_moving: bool = False
    """Whether the camera moves, so that the second and the sixth image show other places."""


def list_windows(clip: Clip, camera: CourtCamera, scale: float) -> Iterator[FrameWindow]:
    """Read the distinct frames of a clip with their neighbours."""
    rows = _find_neighbours(clip)
    decoded = read_planes(clip)
    images: dict[int, PlaneImage] = {}
    frames = clip.distinct_frames
    # index before which neither this frame nor a later one needs an image
    oldest = np.minimum.accumulate(rows.min(axis=1)[::-1])[::-1]
    for k, row in enumerate(rows):
        while max(images, default=-1) < row.max():
            image = reduce_image(PlaneImage(*next(decoded)[1]), scale)
            images[max(images, default=-1) + 1] = image if camera.motion is None else soften_image(image)
        for old in [i for i in images if i < oldest[k]]:
            del images[old]
        yield align_window(int(frames[k]), [images[i] for i in row], find_shifts(camera, frames[row], scale))


def reduce_image(image: PlaneImage, scale: float) -> PlaneImage:
    """Reduce an image to working px."""
    height, width = image.luma.shape
    luma = image.luma if scale == 1 else _resize(image.luma, (round(width * scale), round(height * scale)))
    half = (luma.shape[1] // 2, luma.shape[0] // 2)
    return PlaneImage(luma, image.chroma if image.chroma.shape[1::-1] == half else _resize(image.chroma, half))


def _resize(plane: ByteArray, size: tuple[int, int]) -> ByteArray:
    # Down to half the size, interpolation reads every px as well as an average of areas, which takes six times as long.
    method = cv2.INTER_LINEAR if 2 * size[0] >= plane.shape[1] else cv2.INTER_AREA
    return np.asarray(cv2.resize(plane, size, interpolation=method), np.uint8)


def soften_image(image: PlaneImage) -> PlaneImage:
    """Blur an image of a moving camera, so that moving it between pixels hardly blurs it further.

    Otherwise thin bright lines would differ from their own interpolated images.
    """
    luma, chroma = (np.asarray(cv2.GaussianBlur(p, (3, 3), 0), np.uint8) for p in (image.luma, image.chroma))
    return PlaneImage(luma, chroma)


def align_window(frame: int, images: list[PlaneImage], shifts: FloatArray) -> FrameWindow:
    """Move the nearest and the far neighbours of a frame onto it.

    Args:
        frame: Its index in the file.
        images: Seven, in the order of time.
        shifts: (7, 3, 3) homographies from px of the frame to those of each image.

    Returns:
        The window.
    """
    height, width = images[MIDDLE_IMAGE].luma.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1.0]])
    shifts, shown, is_moving = shifts.copy(), list(images), False
    for k in ALIGNED:
        moved = corners @ shifts[k].T
        if np.abs(moved[:, :2] / moved[:, 2:] - corners[:, :2]).max() > STILL_PX:
            half = TO_HALF @ shifts[k] @ np.linalg.inv(TO_HALF)
            shown[k] = PlaneImage(_move(images[k].luma, shifts[k]), _move(images[k].chroma, half))
            is_moving = True
        shifts[k] = np.eye(3)
    return FrameWindow(frame, tuple(shown), shifts, is_moving)


def _move(plane: ByteArray, shift: FloatArray) -> ByteArray:
    """Move a plane by a homography to its px; its border is continued."""
    flags, size = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, (plane.shape[1], plane.shape[0])
    # OpenCV moves two channels together more slowly than one after the other.
    moved = [
        cv2.warpPerspective(channel, shift, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        for channel in cv2.split(plane)
    ]
    return np.asarray(cv2.merge(moved), np.uint8)


def choose_lags(t: FloatArray) -> tuple[int, int]:
    """Choose by how many frames of times (T,), s, neighbours and far neighbours are away from a frame."""
    interval = float(np.median(np.diff(t)))
    lag = max(1, round(NEIGHBOUR_S / interval))
    return lag, max(2 * lag + 1, round(FAR_S / interval))


def neighbours_of(k: int, first: int, stop: int, lags: tuple[int, int]) -> NDArray[np.int64]:
    """List the rows (7,) of a frame and its neighbours within a view, which contains rows `first` to `stop` - 1."""
    lag, far = lags
    before, after = k - lag >= first, k + lag < stop
    steps = np.array([-far, -2 * lag, -lag, 0, lag, 2 * lag, far])
    if not before:
        steps[1:3] = 2 * lag
    if not after:
        steps[4:6] = -2 * lag
    rows = k + steps
    rows = np.where((rows < first) | (rows >= stop), k - steps, rows)
    return np.asarray(np.clip(rows, first, stop - 1))


def _find_neighbours(clip: Clip) -> NDArray[np.int64]:
    """List the rows (D, 7) of each distinct frame and its neighbours among the distinct frames."""
    frames = clip.distinct_frames
    lags = choose_lags(clip.times_of(frames))
    starts = np.searchsorted(frames, clip.views[:, 0]) if len(clip.views) else np.array([0])
    starts = np.unique(np.concatenate([[0], starts[starts < len(frames)]]))
    stops = np.append(starts[1:], len(frames))
    which = np.searchsorted(starts, np.arange(len(frames)), side="right") - 1
    return np.array([neighbours_of(k, starts[v], stops[v], lags) for k, v in enumerate(which)])


def find_shifts(camera: CourtCamera, frames: NDArray[np.int64], scale: float) -> FloatArray:
    """Compute the homographies (7, 3, 3) from working px of the fourth of seven frames (7,) to those of each.

    They are fitted to a grid of places that the camera's motion and its lens move.
    """
    motion = camera.motion_of(frames)
    if motion is None:
        return np.repeat(np.eye(3)[None], WINDOW, axis=0)
    share = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 4)), axis=-1).reshape(-1, 2)
    grid = share * [camera.width_px - 1, camera.height_px - 1]
    flat = apply_homography(np.linalg.inv(motion[MIDDLE_IMAGE]), camera.undistort(grid))
    moved = camera.distort(apply_homography(motion[:, None], flat))
    shrunk = [(places + 0.5) * scale - 0.5 for places in (grid, *moved)]
    return np.array([cv2.findHomography(shrunk[0], places)[0] for places in shrunk[1:]])
