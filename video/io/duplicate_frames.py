"""Frames of a file that show no moment of their own: repeats of the frame before, and mixtures of two frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, ByteArray, FloatArray

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
        last = measure_nth_largest(cv2.absdiff(self._before[-1], now)) if self._before else np.inf
        third = measure_nth_largest(cv2.absdiff(self._before[0], now)) if len(self._before) == 3 else np.inf
        self._before.append(now)
        return last, third

    @property
    def thumbnail(self) -> NDArray[np.uint8]:
        """The last frame in blocks."""
        return self._before[-1]


def measure_nth_largest(change: ByteArray) -> float:
    """Return the change of rank `CHANGE_RANK`, noise and glints being larger; 0 for smaller arrays."""
    place = change.size - CHANGE_RANK
    return float(np.partition(change, place, axis=None)[place]) if place >= 0 else 0.0


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


# Frames of the camera per frame of the file: 25 to 30 fps and 30 to 25 fps, 24 and 30, 20 and 30, 30 and 50, 24 to 60.
RATIOS = tuple(Fraction(*each) for each in ((5, 6), (6, 5), (4, 5), (5, 4), (2, 3), (3, 2), (3, 5), (5, 3), (2, 5)))
# Periods of moving frames from which a pattern is more than chance.
MIN_PERIODS = 3
# Share of the variance of the changes that the pattern explains, at least (converted clips: 0.5 to 0.8; clips of
# cameras: below 0.1, and up to 0.37 where a hand moves balls at 4 fps).
MIN_AGREEMENT = 0.52
# Strength of the pattern relative to balls that move by more than their diameter from frame to frame: for slower ones
# it is less, and 1 with some noise at most.
STRENGTH_RANGE = (0.35, 1.15)
# Difference of agreements that says nothing: rhythms of 4:5 and 6:5 differ by 0.01 on real mixtures of either.
SAME_AGREEMENT = 0.05
# Relative change of a frame that shows nothing new: coding and noise.
LEAST_CHANGE = 0.05
# Share of the second image up to which a frame is observed: a detector takes so faint a ball for none.
LARGEST_MINOR_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class FrameBlending:
    """How the T frames of a file were mixed of frames of the camera."""

    ratio: Fraction
    """Frames of the camera per frame of the file."""
    place: FloatArray
    """(T,) number of the camera's frame, between two of them where both are mixed."""

    @property
    def is_mixed(self) -> BoolArray:
        """(T,) whether a frame shows two images of which none dominates, or one that was shown before."""
        nearest = np.round(self.place)
        is_mixed: BoolArray = np.abs(self.place - nearest) > LARGEST_MINOR_SHARE
        is_mixed[0] = self.place[0] != nearest[0]  # the first frame is at 0, wherever its images belong
        rows = np.flatnonzero(~is_mixed)
        is_mixed[rows[np.diff(nearest[rows], prepend=-1.0) == 0]] = True
        return is_mixed

    def estimate_times(self, t: FloatArray) -> FloatArray:
        """Estimate the times (T,) at which the camera took the dominating images of frames shown at t (T,), s."""
        rows, order = np.flatnonzero(~self.is_mixed), np.arange(len(t), dtype=np.float64)
        number = rows + (np.round(self.place) - self.place)[rows] / float(self.ratio)
        number = np.interp(order, np.append(0, rows), np.append(0.0, number)) + np.maximum(order - rows[-1], 0)
        interval = float(np.median(np.diff(t)))
        return np.asarray(np.interp(number, order, t) + interval * np.maximum(number - order[-1], 0))


def classify_frames(
    changes: Sequence[tuple[float, float]], has_fields: bool
) -> tuple[BoolArray, BoolArray, FrameBlending | None]:
    """Classify the frames of a file as duplicates, repeated fields and mixtures.

    Args:
        changes: The changes (T, 2) of all frames, as `FrameChangeMeter` measures them.
        has_fields: Whether the frames are fields.

    Returns:
        (T,) whether a frame repeats the one before it, (T,) whether it shows two moments, and how frames were mixed.
    """
    change, third = np.array(changes).T
    is_duplicate, blending = find_duplicate_frames(change, third), find_blending(change, third)
    if has_fields:
        is_duplicate |= find_repeated_fields(change)
    is_mixed = np.zeros(len(change), np.bool_) if blending is None else blending.is_mixed
    return is_duplicate, is_mixed, blending


def find_blending(change: FloatArray, third: FloatArray) -> FrameBlending | None:
    """Find how the frames of a file were mixed.

    Conversions to a higher and to a lower rate can change in the same rhythm, by different amounts.

    Args:
        change: (T,) grey levels, largest change of each frame from the previous one.
        third: (T,) grey levels, largest change from the third frame before.

    Returns:
        The mixture that explains the changes best; None where none does well.
    """
    moving = np.isfinite(change) & np.isfinite(third) & (change >= MIN_MOTION_CHANGE)
    level, level_of_three = (np.log(np.where(moving, np.maximum(each, 1.0), 1.0)) for each in (change, third))
    mixtures: list[tuple[float, float, FrameBlending]] = []
    for ratio in RATIOS:
        period = ratio.denominator
        steady = _select_steady(moving, period)
        if np.count_nonzero(steady) < MIN_PERIODS * period:
            continue
        deviation = _remove_trend(level, period)[steady]
        for offset in range(period):
            place = np.asarray(np.arange(len(change)) * float(ratio) + offset / period, dtype=np.float64)
            expected = np.log(_predict_changes(place, 1))
            pattern = _remove_trend(expected, period)[steady]
            strength = float(deviation @ pattern) / max(float(pattern @ pattern), 1e-9)
            agreement = 1 - float(
                np.sum((deviation - strength * pattern) ** 2) / max(float(np.sum(deviation**2)), 1e-9)
            )
            if STRENGTH_RANGE[0] < strength < STRENGTH_RANGE[1] and agreement > MIN_AGREEMENT:
                ratios = (expected - np.log(_predict_changes(place, 3)))[steady]
                least = ratios < ratios.min() + 1e-6
                misfit = abs(float(np.median((level - level_of_three)[steady][least] - ratios[least])))
                mixtures.append((agreement, misfit, FrameBlending(ratio, place)))
    best = max((agreement for agreement, _, _ in mixtures), default=0.0)
    alike = [one for one in mixtures if one[0] > best - SAME_AGREEMENT]
    return min(alike, key=lambda one: one[1])[2] if alike else None


def _select_steady(moving: BoolArray, period: int) -> BoolArray:
    """Select the frames around which a whole period of frames is moving (T,)."""
    return np.convolve(moving, np.ones(period + 1), "same") > period + 0.5


def _remove_trend(level: FloatArray, period: int) -> FloatArray:
    """Subtract the mean over one period around each frame (T,)."""
    weights = np.ones(period + 1 - period % 2)
    if period % 2 == 0:
        weights[[0, -1]] = 0.5
    return np.asarray(level - np.convolve(level, weights / period, "same"))


def _predict_changes(place: FloatArray, lag: int) -> FloatArray:
    """Predict the largest change (T,) of each frame from the one `lag` before, over that between two camera frames."""
    before = np.concatenate([np.full(lag, -np.inf), place[:-lag]])
    images = np.floor([place, np.where(before < 0, place, before)])
    changes = [np.abs(_measure_shares(place, one) - _measure_shares(before, one)) for one in (*images, *images + 1)]
    return np.asarray(np.maximum(np.max(changes, axis=0), LEAST_CHANGE), dtype=np.float64)


def _measure_shares(place: FloatArray, image: FloatArray) -> FloatArray:
    """Return the share (T,) that a frame of the camera has in each frame of the file, by their numbers."""
    return np.asarray(np.maximum(1 - np.abs(place - image), 0.0), np.float64)
