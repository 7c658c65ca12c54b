"""Views of a recording: stretches of frames without a cut or a fade, and how far the image as a whole moves.

A pass through a file keeps an image of 18 x 32 blocks of each frame. A cut changes more blocks in one frame than
moving people and balls do in several; a fade changes all blocks over some frames, where these change few. A cut from a
fixed camera to itself changes only the places of balls: some are gone, and others lie elsewhere, although nothing moved
from the former or to the latter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import reduce
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, ByteArray, FloatArray

# Columns and rows of blocks: 576 bytes a frame, 62 MB for an hour at 30 frames per second.
BLOCKS = (32, 18)
# Grey levels of mean change at a cut. Cuts between takes of one fixed camera change 1.8 and more.
MIN_CUT_CHANGE = 1.5
# Smallest ratio of this change to that of any frame nearby: up to 2.0 without a cut, 2.7 and more at cuts.
MIN_CUT_RATIO = 2.4
# Frames on each side of a cut: more than two periods of a video with duplicate frames.
NEARBY_FRAMES = 8
# s between two compared frames of a fade.
FADE_GAP_S = 0.12
# Grey levels by which the median block changes over `FADE_GAP_S`: up to 2 where people move, 5 in a fade over 3 s.
MIN_FADE_CHANGE = 4.0
# Grey levels by which a fade changes the median block altogether; less is a camera that adapts its exposure.
MIN_FADE_RANGE = 12.0
# Frames: shorter stretches are no view.
MIN_VIEW_FRAMES = 12
# Grey levels of a pixel of the thumbnail that a ball leaves or takes; coding changes still pixels by up to 10.
MIN_JUMP_CHANGE = 16
# Pixels of a thing that jumps: the smallest ball covers four, one of a close view 25 x 25 / 1.3.
JUMP_AREA = (4, 500)
# Longer side over the shorter, and filled share of the box: a disk fills 0.79, a line of light or a letter less.
MAX_JUMP_ASPECT, MIN_JUMP_FILL = 2.0, 0.4
# Diameters around a thing within which nothing moves before it appears, or after it goes: a ball that stops where it
# hits another one, or is struck, takes or leaves its place in one frame too, but comes from nearby, or rolls on there.
JUMP_CLEARANCE = 4.0
# Smallest ratio of how much a thing differs from its surroundings to how much the place without it does: shadows and
# sleeves that move by a pixel change thin places whose contrast was there before.
MIN_CONTRAST_RATIO = 2.0
# Share of a thing that may change in the frames after it appeared; more is a ball that rolls on.
MAX_MOVED_SHARE = 0.2


class ViewMeter:
    """Collects a small image of every frame, and the things that lie elsewhere from one frame to the next."""

    def __init__(self) -> None:
        self._small: list[ByteArray] = []
        self._recent: deque[ByteArray] = deque(maxlen=2 * NEARBY_FRAMES)
        self._jumps: list[tuple[float, float, float, float]] = []

    def add_frame(self, thumbnail: ByteArray) -> None:
        """Add the thumbnail (h, w) of the next frame."""
        self._small.append(cv2.resize(thumbnail, BLOCKS, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False))
        self._recent.append(thumbnail)
        if len(self._recent) == 2 * NEARBY_FRAMES:
            frame, recent = len(self._small) - NEARBY_FRAMES, list(self._recent)
            jumps = find_jumps(recent[:NEARBY_FRAMES], recent[NEARBY_FRAMES:])
            self._jumps += [(frame, *jump) for jump in jumps]

    @property
    def jumps(self) -> FloatArray:
        """(J, 4) frame, place in shares of width and height, and 1 for a thing that appears, -1 for one that goes.

        Only frames are listed in which some things appear and others go.
        """
        return np.array(self._jumps, np.float64).reshape(-1, 4)

    def find_views(self, t: FloatArray) -> NDArray[np.int64]:
        """Find the views.

        Args:
            t: (T,) s, presentation times of the frames.

        Returns:
            (V, 2) first frame of each view, and the frame after its last one; one row without a cut or a fade.
        """
        count, gap = len(self._small), self._gap(t)
        borders = np.flatnonzero(self._find_cuts())
        views: list[tuple[int, int]] = []
        for first, stop in pairwise([0, *borders.tolist(), count]):
            views += self._split_at_fades(first, stop, gap)
        lasting = [view for view in views if view[1] - view[0] >= MIN_VIEW_FRAMES]
        return np.array(lasting or [(0, count)], np.int64)

    def measure_sway(self, t: FloatArray) -> FloatArray:
        """Measure roughly how far the whole image moves: people who move count too, a registration must confirm it.

        Args:
            t: (T,) s, presentation times of the frames.

        Returns:
            (T,) shares of the width by which a frame differs from that `FADE_GAP_S` before; 0 at the start.
        """
        gap, sway = self._gap(t), np.zeros(len(self._small))
        for k in range(gap, len(sway)):
            before, now = self._small[k - gap].astype(np.float64), self._small[k].astype(np.float64)
            along_y, along_x = np.gradient((before + now) / 2)
            slope = np.stack([along_x.ravel(), along_y.ravel()])
            normal = slope @ slope.T + np.eye(2)  # an image without detail does not move
            shift = np.linalg.solve(normal, slope @ (before - now).ravel())
            sway[k] = float(np.hypot(*shift)) / BLOCKS[0]
        return sway

    def _gap(self, t: FloatArray) -> int:
        """Return the frames that `FADE_GAP_S` spans."""
        return max(round(FADE_GAP_S / float(np.median(np.diff(t)))), 1) if len(t) > 1 else 1

    def _find_cuts(self) -> BoolArray:
        """Mark (T,) the frames that show another view than the frame before."""
        steps = [float(cv2.absdiff(*pair).mean()) for pair in pairwise(self._small)]
        step = np.array([0.0, *steps])
        around = np.pad(step, NEARBY_FRAMES)
        windows = np.lib.stride_tricks.sliding_window_view(around, 2 * NEARBY_FRAMES + 1).copy()
        windows[:, NEARBY_FRAMES] = 0.0
        return np.asarray((step > MIN_CUT_CHANGE) & (step > MIN_CUT_RATIO * windows.max(axis=1)))

    def _split_at_fades(self, first: int, stop: int, gap: int) -> list[tuple[int, int]]:
        """Split frames [first, stop) at fades, whose frames are left out."""
        fading = [k for k in range(first + 1, stop) if self._block_change(max(k - gap, first), k) >= MIN_FADE_CHANGE]
        parts = np.split(np.array(fading, np.int64), np.flatnonzero(np.diff(fading) > gap) + 1) if fading else []
        fades = [(max(int(part[0]) - gap, first), int(part[-1])) for part in parts]
        views, begin = [], first
        for start, last in fades:
            if max(self._block_change(start, k) for k in range(start, last + 1)) >= MIN_FADE_RANGE:
                views.append((begin, start + 1))
                begin = last
        return [*views, (begin, stop)]

    def _block_change(self, one: int, other: int) -> float:
        """Return the median change of the blocks between two frames, grey levels."""
        difference = cv2.absdiff(self._small[one], self._small[other]).ravel()
        middle = difference.size // 2
        return float(np.partition(difference, middle)[middle])


def find_jumps(before: Sequence[ByteArray], after: Sequence[ByteArray]) -> list[tuple[float, float, float]]:
    """Find things of the size of balls that go although nothing moves there later, and that come from nowhere and stay.

    Args:
        before: thumbnails (h, w) of the frames up to one moment.
        after: those from then on.

    Returns:
        Centre in shares of width and height, and 1 for a thing that appears, -1 for one that goes; empty without both.
    """
    stepped = _differ(before[-1], after[0])
    if cv2.countNonZero(stepped) < 2 * JUMP_AREA[0]:
        return []
    _, labels, stats, centres = cv2.connectedComponentsWithStats(stepped)
    x, y, width, height, area = stats.T
    longer, shorter = np.maximum(width, height), np.minimum(width, height)
    is_round = (longer <= MAX_JUMP_ASPECT * shorter) & (area >= MIN_JUMP_FILL * width * height)
    is_round &= (area >= JUMP_AREA[0]) & (area <= JUMP_AREA[1])
    is_round[0] = False  # the background
    if np.count_nonzero(is_round) < 2:
        return []
    moves = [reduce(cv2.bitwise_or, (_differ(image, side[0]) for image in side[1:])) for side in (before[::-1], after)]
    clearances = [cv2.distanceTransform(255 - moved, cv2.DIST_L2, 3) for moved in moves]
    things = []
    for k in np.flatnonzero(is_round):
        box = slice(max(y[k] - 2, 0), y[k] + height[k] + 2), slice(max(x[k] - 2, 0), x[k] + width[k] + 2)
        thing, place = labels[box] == k, tuple(centres[k, ::-1].round().astype(int))
        contrasts = [_measure_contrast(image[box], thing) for image in (before[-1], after[0])]
        appears = contrasts[1] > contrasts[0]
        if max(contrasts) < max(MIN_JUMP_CHANGE, MIN_CONTRAST_RATIO * min(contrasts)):
            continue
        clearance = clearances[0 if appears else 1][place]
        stays = not appears or np.mean(moves[1][box][thing] > 0) < MAX_MOVED_SHARE
        if stays and clearance >= JUMP_CLEARANCE * longer[k]:
            share = (centres[k] + 0.5) / stepped.shape[::-1]
            things.append((float(share[0]), float(share[1]), 1.0 if appears else -1.0))
    return things if {sign for _, _, sign in things} == {-1.0, 1.0} else []


def _differ(one: ByteArray, other: ByteArray) -> ByteArray:
    """Mark (h, w) with 255 the pixels that differ clearly."""
    changed = cv2.threshold(cv2.absdiff(one, other), MIN_JUMP_CHANGE, 255, cv2.THRESH_BINARY)[1]
    return np.asarray(changed, np.uint8)


def _measure_contrast(image: ByteArray, thing: BoolArray) -> float:
    """Measure by how many grey levels a thing differs from what surrounds it."""
    return abs(float(np.median(image[thing])) - float(np.median(image[~thing])))
