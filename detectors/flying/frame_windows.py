"""Frames beside their neighbours in time, aligned where the camera turns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.court_camera import CourtCamera
from models.core.typing import ByteArray, FloatArray
from video.io.clip import Clip, read_frames

# s from a frame to its neighbours, about: at higher frame rates a slow object would cover its own place.
NEIGHBOUR_S = 1 / 30
# px by which the camera may move between neighbours without being followed: less than coding moves edges.
STILL_PX = 0.1


@dataclass(frozen=True, slots=True)
class FrameWindow:
    """A frame and its neighbours at steps of about `NEIGHBOUR_S`, in working px: luma, reduced by a scale."""

    frame: int
    """Index in the file."""
    images: tuple[ByteArray, ByteArray, ByteArray, ByteArray, ByteArray]
    """(H, W) each, in the order of time; at the ends of a view, neighbours of the other side replace missing ones. The
    second and the fourth show the places of the third, the frame itself.
    """
    shifts: FloatArray
    """(5, 3, 3) homographies from px of the frame to those of each image."""


def list_windows(clip: Clip, camera: CourtCamera, scale: float) -> Iterator[FrameWindow]:
    """Read the distinct frames of a clip with their neighbours."""
    rows = _find_neighbours(clip)
    grey = read_frames(clip, grey=True)
    images: dict[int, ByteArray] = {}
    frames = clip.distinct_frames
    for k, row in enumerate(rows):
        while max(images, default=-1) < rows[k].max():
            image = reduce_image(next(grey)[1], scale)
            images[max(images, default=-1) + 1] = image if camera.motion is None else soften_image(image)
        for old in [i for i in images if i < rows[k:].min()]:
            del images[old]
        yield align_window(int(frames[k]), [images[i] for i in row], find_shifts(camera, frames[row], scale))


def reduce_image(image: ByteArray, scale: float) -> ByteArray:
    """Reduce an image to working px."""
    if scale == 1:
        return image
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def soften_image(image: ByteArray) -> ByteArray:
    """Blur an image of a moving camera, so that moving it between pixels hardly blurs it further.

    Otherwise thin bright lines would differ from their own interpolated images.
    """
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0), np.uint8)


def align_window(frame: int, images: list[ByteArray], shifts: FloatArray) -> FrameWindow:
    """Move the two nearest neighbours of a frame onto it.

    Args:
        frame: Its index in the file.
        images: Five images (H, W) in the order of time.
        shifts: (5, 3, 3) homographies from px of the frame to those of each image.

    Returns:
        The window.
    """
    height, width = images[2].shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1.0]])
    shifts, shown = shifts.copy(), list(images)
    for k in (1, 3):
        moved = corners @ shifts[k].T
        if np.abs(moved[:, :2] / moved[:, 2:] - corners[:, :2]).max() > STILL_PX:
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            shown[k] = cv2.warpPerspective(
                images[k], shifts[k], (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
            )
        shifts[k] = np.eye(3)
    return FrameWindow(frame, (shown[0], shown[1], shown[2], shown[3], shown[4]), shifts)


def choose_lag(t: FloatArray) -> int:
    """Choose by how many frames of times (T,), s, neighbours are apart."""
    return max(1, round(NEIGHBOUR_S / float(np.median(np.diff(t)))))


def neighbours_of(k: int, first: int, stop: int, lag: int) -> NDArray[np.int64]:
    """List the rows (5,) of a frame and its neighbours within a view, which contains rows `first` to `stop` - 1."""
    before, after = k - lag >= first, k + lag < stop
    steps = np.array([-2, -1, 0, 1, 2]) * lag
    if not before:
        steps[:2] = -steps[[0, 0]]
    if not after:
        steps[3:] = -steps[[4, 4]]
    rows = k + steps
    rows = np.where((rows < first) | (rows >= stop), k - steps, rows)
    return np.asarray(np.clip(rows, first, stop - 1))


def _find_neighbours(clip: Clip) -> NDArray[np.int64]:
    """List the rows (D, 5) of each distinct frame and its neighbours among the distinct frames."""
    frames = clip.distinct_frames
    lag = choose_lag(clip.times_of(frames))
    starts = np.searchsorted(frames, clip.views[:, 0]) if len(clip.views) else np.array([0])
    starts = np.unique(np.concatenate([[0], starts[starts < len(frames)]]))
    stops = np.append(starts[1:], len(frames))
    which = np.searchsorted(starts, np.arange(len(frames)), side="right") - 1
    return np.array([neighbours_of(k, starts[v], stops[v], lag) for k, v in enumerate(which)])


def find_shifts(camera: CourtCamera, frames: NDArray[np.int64], scale: float) -> FloatArray:
    """Compute the homographies (5, 3, 3) from working px of the third of five frames (5,) to those of each."""
    motion = camera.motion_of(frames)
    if motion is None:
        return np.repeat(np.eye(3)[None], 5, axis=0)
    shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1]])
    moved = shrink @ motion @ np.linalg.inv(motion[2]) @ np.linalg.inv(shrink)
    return np.asarray(moved / moved[:, 2:, 2:])
