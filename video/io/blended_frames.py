"""Recognition of frames that a conversion of the frame rate mixed of two frames of the camera.

A converter from 25 to 30 fps shows, between two frames of the camera, means of both: a ball appears twice, half
transparent. The largest change from frame to frame is then smaller where a frame shares more with the one before it,
with a period of a few frames. Frames that one image dominates show its ball where it was when the camera took it;
the others show it nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.core.typing import BoolArray, FloatArray
from video.io.duplicate_frames import MIN_MOTION_CHANGE, find_duplicate_frames, find_repeated_fields

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
