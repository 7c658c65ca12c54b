"""Detection of duplicate frames, which repeat the image of the frame before them.

A container may store a frame two or three times (15 fps in a 30 fps file, 25 in a 60 fps one), and coding makes the
copies differ slightly. A copy is recognised where something moves: a frame without change lies between frames with
clear changes. Nothing is concluded from a still scene alone; undecided frames count as observations.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

# px. A block of the thumbnail averages the noise of at least 2 x 2 pixels; a ball still covers several blocks.
THUMBNAIL_HEIGHT = 180

# The change of a frame is the fourth largest of all blocks: one flickering block is no motion, and the smallest ball
# covers four.
CHANGE_RANK = 4

# Grey levels: largest change of a duplicate frame by coding alone (real clips: 1 to 3).
MAX_DUPLICATE_CHANGE = 4.0

# Largest change of a duplicate relative to its neighbours', where it is a key frame (real clips: below 0.06).
MAX_DUPLICATE_CHANGE_SHARE = 0.08

# Grey levels: a ball moves by about a pixel or more. Below this, encoders may drop slow motion by themselves.
MIN_MOTION_CHANGE = 24.0

# Grey levels: above this a frame is no duplicate, unless its neighbours changed far more.
MIN_DISTINCT_CHANGE = 10.0

# Frames: longest run of duplicates (10 fps in a 60 fps container); longer runs are a scene at rest.
MAX_DUPLICATE_RUN = 5

MIN_DUPLICATES = 3
# Smallest number of duplicates, and smallest share among frames with motion: a container with duplicates has them
# regularly. A cue that reverses, or a ball that leaves a cushion where it arrived, resembles a single duplicate.
MIN_DUPLICATE_SHARE = 0.03

# A ball that reverses at a cushion gives two equal frames, then the one before them again: the change over three frames
# is below this share of the changes on both sides. Around a duplicate during a motion it is larger.
MAX_REVERSAL_SHARE = 0.25

# Largest change, relative to its neighbours', of a frame that the cadence marks as duplicate: encoders lag behind slow
# motion.
MAX_CADENCE_CHANGE_SHARE = 0.5

# Largest change of a second field relative to that of a first one where both show one moment: the lines between are
# interpolated, which changes sharp edges. Of two moments the changes are alike.
MAX_FIELD_CHANGE_SHARE = 0.6

# Frames: the pattern of 25 fps in a 60 fps container has a period of 12.
MAX_PERIOD = 12


class FrameChangeMeter:
    """Measures in constant memory how much each frame differs from the frames before it."""

    def __init__(self) -> None:
        self._before: deque[NDArray[np.uint8]] = deque(maxlen=3)

    def measure_change(self, grey: NDArray[np.uint8]) -> tuple[float, float]:
        """Measure the change to the next frame.

        Args:
            grey: (H, W) luma of the next frame.

        Returns:
            Grey levels by which it differs from the previous frame and from the third frame before; infinite where
            there is none.
        """
        height, width = grey.shape
        block = max(2, height // THUMBNAIL_HEIGHT)
        size = (max(width // block, 1), max(height // block, 1))
        now = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
        last = _nth_largest_difference(self._before[-1], now) if self._before else np.inf
        third = _nth_largest_difference(self._before[0], now) if len(self._before) == 3 else np.inf
        self._before.append(now)
        return last, third

    @property
    def thumbnail(self) -> NDArray[np.uint8]:
        """The last frame in blocks."""
        return self._before[-1]


def _nth_largest_difference(before: NDArray[np.uint8], now: NDArray[np.uint8]) -> float:
    flat = cv2.absdiff(before, now).ravel()
    place = max(flat.size - CHANGE_RANK, 0)
    return float(np.partition(flat, place)[place])


def find_duplicate_frames(change: FloatArray, third: FloatArray) -> NDArray[np.bool_]:
    """Find the frames that repeat the frame before them.

    Args:
        change: (T,) grey levels, change from the previous frame, as `FrameChangeMeter` measures it.
        third: (T,) grey levels, change from the third frame before.

    Returns:
        (T,) True for duplicate frames.
    """
    between = _find_quiet_runs(change, third)
    moving = np.count_nonzero(change[1:] >= MIN_MOTION_CHANGE)
    duplicates = np.count_nonzero(between)
    if duplicates < MIN_DUPLICATES or duplicates < MIN_DUPLICATE_SHARE * (duplicates + moving):
        return np.zeros(len(change), np.bool_)
    period = _find_period(change, between)
    return between if period is None else between | _extrapolate_cadence(change, between, period)


def find_repeated_fields(change: FloatArray) -> NDArray[np.bool_]:
    """Find the second fields of frames that a camera took as a whole and stored as two fields.

    Args:
        change: (T,) grey levels, change from the previous field, of a video of fields alone.

    Returns:
        (T,) True for all second fields where they show the moment of the first ones.
    """
    count = len(change) // 2
    first, second = change[2 : 2 * count : 2], change[3 : 2 * count : 2]
    moving = first >= MIN_MOTION_CHANGE
    repeats = np.zeros(len(change), np.bool_)
    if np.count_nonzero(moving) >= MIN_DUPLICATES:
        repeats[1::2] = np.median(second[moving] / first[moving]) < MAX_FIELD_CHANGE_SHARE
    return repeats


def _find_quiet_runs(change: FloatArray, third: FloatArray) -> NDArray[np.bool_]:
    """Mark (T,) short runs of frames without change that are enclosed by clear motion."""
    marked = np.zeros(len(change), np.bool_)
    loud = 1 + np.flatnonzero(change[1:] >= MIN_MOTION_CHANGE)
    for before, after in pairwise(loud):
        least = min(change[before], change[after])
        inside = slice(before + 1, after)
        is_reversal = after - before == 2 and third[after] <= MAX_REVERSAL_SHARE * least
        is_quiet = np.all(change[inside] <= max(MAX_DUPLICATE_CHANGE, MAX_DUPLICATE_CHANGE_SHARE * least))
        if 1 < after - before <= MAX_DUPLICATE_RUN + 1 and is_quiet and not is_reversal:
            marked[inside] = True
    return marked


def _find_period(change: FloatArray, copies: NDArray[np.bool_]) -> int | None:
    """Find the period after which the pattern of duplicates recurs; None where there is none."""
    distinct = ~copies & (change >= MIN_DISTINCT_CHANGE)
    for period in range(2, MAX_PERIOD + 1):
        alike = np.count_nonzero(copies[period:] & copies[:-period])
        unlike = np.count_nonzero((copies[period:] & distinct[:-period]) | (distinct[period:] & copies[:-period]))
        if alike >= 2 * MIN_DUPLICATES and alike >= 0.9 * (alike + unlike):
            return period
    return None


def _extrapolate_cadence(change: FloatArray, is_duplicate: NDArray[np.bool_], period: int) -> NDArray[np.bool_]:
    """Mark (T,) undecided frames that change little and are duplicates by the cadence, continued from both sides."""
    states = np.where(is_duplicate, 1, np.where(change >= MIN_DISTINCT_CHANGE, -1, 0))
    onward = _fill_from_previous_period(states, period)
    backward = _fill_from_previous_period(states[::-1], period)[::-1]
    agreed = (onward + backward > 0) & (states == 0)
    around = np.minimum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    return np.asarray(agreed & (change <= np.maximum(MAX_DUPLICATE_CHANGE, MAX_CADENCE_CHANGE_SHARE * around)))


def _fill_from_previous_period(states: NDArray[np.int_], period: int) -> NDArray[np.int_]:
    """Fill each undecided state (1 duplicate, -1 distinct, 0 undecided) with the state one period earlier."""
    filled = states.copy()
    for i in range(period, len(filled)):
        if filled[i] == 0:
            filled[i] = filled[i - period]
    return filled
