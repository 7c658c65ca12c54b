"""Which pictures only show again what the picture before them showed.

A container may show a picture twice or thrice (15 pictures per second in a 30 fps file, 25 in a 60 fps one), and coding
makes the copies differ a little. A copy gives itself away where something moves: between two pictures with clear
changes there is one with none. A still scene gives nothing away, so nothing is concluded from it alone; what is
undecided is an observation.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

THUMBNAIL_HEIGHT = 180
"""px. A block of the thumbnail averages the noise of at least 2 x 2 pixels; a ball still covers several blocks."""

RANK = 4
"""A change is the fourth largest of all blocks: one twinkling block is no motion, and the smallest ball covers four."""

QUIET = 4.0
"""Grey levels: the most that coding alone changed in repeats (real clips: 1 to 3)."""

QUIET_SHARE = 0.08
"""A repeat's change against that of its neighbours, where a key frame falls on it (real clips: below 0.06)."""

MOVING = 24.0
"""Grey levels: a ball that goes on by about a pixel or more. Below this a coder may leave out slow motion by itself."""

CLEAR = 10.0
"""Grey levels: above this a picture is no repeat, unless its neighbours changed far more."""

LONGEST_RUN = 5
"""Pictures shown again in a row (10 per second in a 60 fps container); longer standstills are rest, not repeats."""

FEWEST = 3
LEAST_SHARE = 0.03
"""A container that repeats does so by habit: at least so many, and so large a share of the pictures while things move.
A cue that turns round, or a ball that leaves a cushion at the place where it came, looks like one repeat, once."""

CAME_BACK = 0.25
"""A ball that leaves a cushion where it came shows two pictures alike, and then the one before them again: the change
over three pictures is below this share of those on both sides. Around a repeat in a motion it is larger."""

SLOWED = 0.5
"""Share of its neighbours' change that a picture due to be a repeat may have: coding catches up on slow motion late."""

LONGEST_PERIOD = 12
"""Pictures: 25 per second in a 60 fps container comes round after 12."""


class ChangeMeter:
    """Measures how much each picture differs from those before, in constant memory."""

    def __init__(self) -> None:
        self._before: deque[NDArray[np.uint8]] = deque(maxlen=3)

    def change(self, grey: NDArray[np.uint8]) -> tuple[float, float]:
        """Grey levels from the picture before to this one (H, W), and from the third before; infinite where none is."""
        height, width = grey.shape
        block = max(2, height // THUMBNAIL_HEIGHT)
        size = (max(width // block, 1), max(height // block, 1))
        now = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
        last = _ranked(self._before[-1], now) if self._before else np.inf
        third = _ranked(self._before[0], now) if len(self._before) == 3 else np.inf
        self._before.append(now)
        return last, third


def _ranked(before: NDArray[np.uint8], now: NDArray[np.uint8]) -> float:
    flat = cv2.absdiff(before, now).ravel()
    place = max(flat.size - RANK, 0)
    return float(np.partition(flat, place)[place])


def mark_repeats(change: FloatArray, third: FloatArray) -> NDArray[np.bool_]:
    """(F,) True where a picture repeats the one before, from both changes (F,) of `ChangeMeter`, grey levels."""
    between = _between_motion(change, third)
    moving = np.count_nonzero(change[1:] >= MOVING)
    found = np.count_nonzero(between)
    if found < FEWEST or found < LEAST_SHARE * (found + moving):
        return np.zeros(len(change), np.bool_)
    period = _cadence(change, between)
    return between if period is None else between | _continued(change, between, period)


def _between_motion(change: FloatArray, third: FloatArray) -> NDArray[np.bool_]:
    """(F,) True in short runs of pictures without a change that clear motion encloses."""
    marked = np.zeros(len(change), np.bool_)
    loud = 1 + np.flatnonzero(change[1:] >= MOVING)
    for before, after in pairwise(loud):
        least = min(change[before], change[after])
        inside = slice(before + 1, after)
        turned = after - before == 2 and third[after] <= CAME_BACK * least
        quiet = np.all(change[inside] <= max(QUIET, QUIET_SHARE * least))
        if 1 < after - before <= LONGEST_RUN + 1 and quiet and not turned:
            marked[inside] = True
    return marked


def _cadence(change: FloatArray, repeat: NDArray[np.bool_]) -> int | None:
    """The period of the repeats, where they keep one: pictures a period apart are both repeats or both not."""
    distinct = ~repeat & (change >= CLEAR)
    for period in range(2, LONGEST_PERIOD + 1):
        alike = np.count_nonzero(repeat[period:] & repeat[:-period])
        unlike = np.count_nonzero((repeat[period:] & distinct[:-period]) | (distinct[period:] & repeat[:-period]))
        if alike >= 2 * FEWEST and alike >= 0.9 * (alike + unlike):
            return period
    return None


def _continued(change: FloatArray, repeat: NDArray[np.bool_], period: int) -> NDArray[np.bool_]:
    """(F,) True where the cadence, carried on from both sides, says repeat and the picture does not object."""
    known = np.where(repeat, 1, np.where(change >= CLEAR, -1, 0))
    onward = _carry(known, period)
    backward = _carry(known[::-1], period)[::-1]
    agreed = (onward + backward > 0) & (known == 0)
    around = np.minimum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    return np.asarray(agreed & (change <= np.maximum(QUIET, SLOWED * around)))


def _carry(known: NDArray[np.int_], period: int) -> NDArray[np.int_]:
    """`known` (1 repeat, -1 distinct, 0 open) with every open place taken from one period earlier."""
    carried = known.copy()
    for i in range(period, len(carried)):
        if carried[i] == 0:
            carried[i] = carried[i - period]
    return carried
