"""A long recording cut into shots: a table that lies still, a strike, balls that run, and rest again; and the cuts of a
broadcast, between which each view is a recording of its own."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.progress import Progress, silent
from models.core.typing import ByteArray, FloatArray
from video.calibration.cloth_region import find_cloths
from video.io.clip import Clip, read_frames

HEIGHT = 180
"""px of the reduced picture: the smallest ball of a table that fills the picture covers four of its pixels."""
CUT = 12.0
"""Grey levels that a cut changes a picture by, on average; a player who walks by changes less than five."""
CUT_TIMES = 5.0
"""How often the usual change of the pictures before: a camera that pans changes every picture."""
USUAL = 12
"""Pictures over which a change is usual."""
APART_S = 0.12
"""s between two pictures that are compared: a ball of 5 mm/s is not at rest, and goes half a millimetre."""
MOVING = 16.0
"""Grey levels of the fourth largest change of all places on the cloth; coding and a flickering lamp make up to 10."""
RANK = 4
"""One twinkling place is no motion."""
STILL_S = 1.0
"""s without motion that part two shots."""
SHORTEST_S = 0.25
"""s of motion; shorter ones are a light that is switched."""
MARGIN_S = 0.5
"""s of stillness that a shot keeps before and after its motion: what rests is known better the longer it is seen."""
LONG_S = 12.0
"""s above which a clip may hold several shots."""


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """The shots of a recording, in order, none over another."""

    first: NDArray[np.int64]
    """(S,) picture of the recording with which each begins."""
    stop: NDArray[np.int64]
    """(S,) picture before which it ends."""
    cuts: NDArray[np.int64]
    """(C,) pictures that show another view than the one before."""

    def __post_init__(self) -> None:
        if self.first.shape != self.stop.shape or np.any(self.stop <= self.first):
            raise ValueError("Shots.first and Shots.stop must be (S,) alike, each stop after its first")

    def __len__(self) -> int:
        return len(self.first)


def find_shots(clip: Clip, progress: Progress = silent) -> Shots:
    """Look through a recording once. A view without a cloth holds no shot, nor does one in which nothing moves."""
    views, change = _look_through(clip, progress)
    spans = [span for view in pairwise([*views, clip.frame_count]) for span in motions(clip.t, change, *view)]
    first, stop = np.array(spans, np.int64).reshape(-1, 2).T
    return Shots(first, stop, np.array(views[1:], np.int64))


def motions(t: FloatArray, change: FloatArray, begin: int, end: int) -> list[tuple[int, int]]:
    """Spans of pictures [first, stop) within [begin, end) in which something moves, with stillness around them.

    t (F,) s; change (F,) grey levels on the cloth, NaN where there is none.
    """
    busy = begin + np.flatnonzero(change[begin:end] > MOVING)
    if not len(busy):
        return []
    parts = np.split(busy, np.flatnonzero(np.diff(t[busy]) > STILL_S) + 1)
    spans = [(t[part[0]] - APART_S, t[part[-1]]) for part in parts if t[part[-1]] - t[part[0]] >= SHORTEST_S]
    kept = []
    for k, (start, stop) in enumerate(spans):
        least = (spans[k - 1][1] + start) / 2 if k else -np.inf
        most = (stop + spans[k + 1][0]) / 2 if k + 1 < len(spans) else np.inf
        from_, to = np.searchsorted(t, [max(start - MARGIN_S, least), min(stop + MARGIN_S, most)])
        kept.append((int(max(from_, begin)), int(min(to + 1, end))))
    return [(a, min(b, c)) for (a, b), (c, _) in pairwise([*kept, (end, end)])]


def _look_through(clip: Clip, progress: Progress) -> tuple[list[int], FloatArray]:
    """First pictures of the views, and (F,) the change on the cloth of each picture."""
    views, change = [0], np.full(clip.frame_count, np.nan)
    usual, before = deque[float](maxlen=USUAL), deque[tuple[float, ByteArray]]()
    mask: ByteArray | None = None
    for frame, picture in read_frames(clip, indices=np.arange(clip.frame_count)):
        small = _reduced(picture)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.uint8)
        step = float(cv2.absdiff(before[-1][1], grey).mean()) if before else 0.0
        if before and step > CUT and step > CUT_TIMES * float(np.median(usual or [0.0])):
            views.append(frame)
            usual.clear()
            before.clear()
        elif before:
            usual.append(step)
        if not before:
            mask = _cloth(small)
        while len(before) > 1 and clip.t[frame] - before[1][0] >= APART_S:
            before.popleft()
        if mask is not None and before:
            change[frame] = _largest(cv2.absdiff(before[0][1], grey)[mask > 0])
        before.append((float(clip.t[frame]), grey))
        progress((frame + 1) / clip.frame_count)
    return views, change


def _reduced(picture: ByteArray) -> ByteArray:
    height, width = picture.shape[:2]
    if height <= HEIGHT:
        return picture
    size = (max(width * HEIGHT // height, 1), HEIGHT)
    small: ByteArray = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small


def _cloth(picture: ByteArray) -> ByteArray | None:
    """Where the cloth is in a picture; None where it shows no table."""
    found = find_cloths(picture, 1)
    if not found:
        return None
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, found[0].corners.round().astype(np.int32), 255)
    return mask


def _largest(change: ByteArray) -> float:
    place = change.size - RANK
    return float(np.partition(change, place)[place]) if place >= 0 else 0.0
