"""Views of a recording: stretches of frames without a cut or a fade, and how far the image as a whole moves.

A pass through a file keeps an image of 18 x 32 blocks of each frame. A cut changes more blocks in one frame than
moving people and balls do in several; a fade changes all blocks over some frames, where these change few.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, ByteArray, FloatArray

BLOCKS = (32, 18)
"""Columns and rows of blocks: 576 bytes a frame, 62 MB for an hour at 30 frames per second."""
MIN_CUT_CHANGE = 1.5
"""Grey levels of mean change at a cut. Cuts between takes of one fixed camera change 1.8 and more."""
MIN_CUT_RATIO = 2.4
"""Smallest ratio of this change to that of any frame nearby: up to 2.0 without a cut, 2.7 and more at cuts."""
NEARBY_FRAMES = 8
"""Frames on each side of a cut: more than two periods of a video with duplicate frames."""
FADE_GAP_S = 0.12
"""s between two compared frames of a fade."""
MIN_FADE_CHANGE = 4.0
"""Grey levels by which the median block changes over `FADE_GAP_S`: up to 2 where people move, 5 in a fade over 3 s."""
MIN_FADE_RANGE = 12.0
"""Grey levels by which a fade changes the median block altogether; less is a camera that adapts its exposure."""
MIN_VIEW_FRAMES = 12
"""Frames: shorter stretches are no view."""


class ViewMeter:
    """Collects a small image of every frame."""

    def __init__(self) -> None:
        self._small: list[ByteArray] = []

    def add_frame(self, thumbnail: ByteArray) -> None:
        """Add the thumbnail (h, w) of the next frame."""
        self._small.append(cv2.resize(thumbnail, BLOCKS, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False))

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
            if self._block_change(start, last) >= MIN_FADE_RANGE:
                views.append((begin, start + 1))
                begin = last
        return [*views, (begin, stop)]

    def _block_change(self, one: int, other: int) -> float:
        """Return the median change of the blocks between two frames, grey levels."""
        difference = cv2.absdiff(self._small[one], self._small[other]).ravel()
        middle = difference.size // 2
        return float(np.partition(difference, middle)[middle])
