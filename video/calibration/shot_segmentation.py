"""Segmentation of a long recording into shots: still balls, a strike, motion, and rest again.

Cuts of a broadcast are detected as well; the views between them are treated as recordings of their own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.progress import Progress, ignore_progress
from models.core.typing import ByteArray, FloatArray
from video.calibration.cloth_region import find_cloth_regions
from video.io.clip import Clip, read_frames

SCAN_HEIGHT_PX = 180
"""px, height of the reduced frame: the smallest ball of a table that fills the frame covers four of its pixels."""
MIN_CUT_CHANGE = 12.0
"""Grey levels, smallest mean change at a cut; a player who walks past changes less than five."""
MIN_CUT_RATIO = 5.0
"""Smallest ratio of the change at a cut to the usual change before: a camera that pans changes every frame."""
USUAL_CHANGE_FRAMES = 12
"""Number of frames whose median change is the usual one."""
COMPARISON_GAP_S = 0.12
"""s between two compared frames: a ball at 5 mm/s is not at rest and moves half a millimetre."""
MIN_MOTION_CHANGE = 16.0
"""Grey levels of the fourth largest change on the cloth; coding and a flickering lamp reach up to 10."""
CHANGE_RANK = 4
"""Rank of the change that is used: one flickering pixel is no motion."""
MIN_STILLNESS_S = 1.0
"""s without motion that separate two shots."""
MIN_MOTION_S = 0.25
"""s of motion; shorter ones are a light that is switched."""
MARGIN_S = 0.5
"""s of stillness before and after the motion of a shot: longer observation of balls at rest is more precise."""
LONG_RECORDING_S = 12.0
"""s above which a clip may contain several shots."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotIntervals:
    """The S shots of a recording, in order and without overlap."""

    first_frames: NDArray[np.int64]
    """(S,) first frame of each shot."""
    stop_frames: NDArray[np.int64]
    """(S,) frame after the last one of each shot."""
    cut_frames: NDArray[np.int64]
    """(C,) frames that show another view than the frame before."""

    def __post_init__(self) -> None:
        if self.first_frames.shape != self.stop_frames.shape or np.any(self.stop_frames <= self.first_frames):
            raise ValueError("ShotIntervals.first_frames and stop_frames must both be (S,), each stop after its first")

    def __len__(self) -> int:
        return len(self.first_frames)


def segment_shots(clip: Clip, progress: Progress = ignore_progress) -> ShotIntervals:
    """Segment a recording into shots. A view without a cloth contains no shot, nor does one without motion.

    Args:
        clip: the recording.
        progress: is called with the share that has been read, 0 to 1.

    Returns:
        The shots and the cuts between views.
    """
    views, change = _measure_changes(clip, progress)
    intervals = [
        interval
        for view in pairwise([*views, clip.frame_count])
        for interval in find_motion_intervals(clip.t, change, *view)
    ]
    first, stop = np.array(intervals, np.int64).reshape(-1, 2).T
    return ShotIntervals(first, stop, np.array(views[1:], np.int64))


def find_motion_intervals(t: FloatArray, change: FloatArray, begin: int, end: int) -> list[tuple[int, int]]:
    """Find the intervals of motion within frames [begin, end), extended by stillness.

    Args:
        t: (T,) s, presentation times.
        change: (T,) grey levels of change on the cloth; NaN where there is no cloth.
        begin: first frame to consider.
        end: frame after the last one to consider.

    Returns:
        Intervals [first, stop) of frames, in order and without overlap.
    """
    moving = begin + np.flatnonzero(change[begin:end] > MIN_MOTION_CHANGE)
    if not len(moving):
        return []
    parts = np.split(moving, np.flatnonzero(np.diff(t[moving]) > MIN_STILLNESS_S) + 1)
    intervals = [
        (t[part[0]] - COMPARISON_GAP_S, t[part[-1]]) for part in parts if t[part[-1]] - t[part[0]] >= MIN_MOTION_S
    ]
    padded = []
    for k, (start, stop) in enumerate(intervals):
        least = (intervals[k - 1][1] + start) / 2 if k else -np.inf
        most = (stop + intervals[k + 1][0]) / 2 if k + 1 < len(intervals) else np.inf
        first, to = np.searchsorted(t, [max(start - MARGIN_S, least), min(stop + MARGIN_S, most)])
        padded.append((int(max(first, begin)), int(min(to + 1, end))))
    return [(a, min(b, c)) for (a, b), (c, _) in pairwise([*padded, (end, end)])]


def _measure_changes(clip: Clip, progress: Progress) -> tuple[list[int], FloatArray]:
    """Return the first frames of all views, and (T,) the change on the cloth of each frame."""
    views, change = [0], np.full(clip.frame_count, np.nan)
    usual, recent = deque[float](maxlen=USUAL_CHANGE_FRAMES), deque[tuple[float, ByteArray]]()
    mask: ByteArray | None = None
    for frame, image in read_frames(clip, indices=np.arange(clip.frame_count)):
        small = _downscale_frame(image)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.uint8)
        step = float(cv2.absdiff(recent[-1][1], grey).mean()) if recent else 0.0
        if recent and step > MIN_CUT_CHANGE and step > MIN_CUT_RATIO * float(np.median(usual or [0.0])):
            views.append(frame)
            usual.clear()
            recent.clear()
        elif recent:
            usual.append(step)
        if not recent:
            mask = _cloth_mask(small)
        while len(recent) > 1 and clip.t[frame] - recent[1][0] >= COMPARISON_GAP_S:
            recent.popleft()
        if mask is not None and recent:
            change[frame] = _nth_largest_change(cv2.absdiff(recent[0][1], grey)[mask > 0])
        recent.append((float(clip.t[frame]), grey))
        progress((frame + 1) / clip.frame_count)
    return views, change


def _downscale_frame(image: ByteArray) -> ByteArray:
    height, width = image.shape[:2]
    if height <= SCAN_HEIGHT_PX:
        return image
    size = (max(width * SCAN_HEIGHT_PX // height, 1), SCAN_HEIGHT_PX)
    small: ByteArray = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small


def _cloth_mask(image: ByteArray) -> ByteArray | None:
    """Mask (H, W) of the cloth; None where the frame shows no table."""
    regions = find_cloth_regions(image, 1)
    if not regions:
        return None
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, regions[0].corners.round().astype(np.int32), 255)
    return mask


def _nth_largest_change(change: ByteArray) -> float:
    """Return the change of rank `CHANGE_RANK`; 0 for smaller arrays."""
    place = change.size - CHANGE_RANK
    return float(np.partition(change, place)[place]) if place >= 0 else 0.0
