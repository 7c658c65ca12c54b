"""Detection of frames that are missing without a trace in their times: everything that moves jumps ahead at once.

A ball that jumps ahead keeps its direction and its speed, which no contact does. Around every frame, the paths of all
moving balls are therefore fitted by parabolas in a time with a pause of 0, 1, 2, ... frames; the pause of least chi2 is
accepted where it explains the paths well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray

_FRAMES_PER_SIDE = 6
"""Frames on either side: a parabola is a good model over twice as many."""
_MIN_FRAMES_PER_SIDE = 4
"""Least frames on a side near a contact."""
_MAX_LOST_FRAMES = 15
"""Largest number of frames lost at once."""
_MIN_CHI2_GAIN = 40.0
"""Decrease of chi2 that a pause must achieve."""
_MAX_CHI2 = 3.0
"""chi2 per degree of freedom up to which a pause explains the paths."""
_MIN_VELOCITY_SHARE = 0.4
"""Share of the larger of two velocities that the smaller one keeps along it: a strike or a contact keeps less."""


@dataclass(frozen=True, slots=True)
class TimeJump:
    """Frames lost after one frame."""

    after: int
    """Row of the recording after which they are missing."""
    lost_frames: int
    """Number of missing frames."""
    gain: float
    """Decrease of chi2 by the pause."""


def find_time_jumps(recording: Recording, interval: float, expected: bool = False) -> tuple[TimeJump, ...]:
    """Find lost frames, in the order of time.

    Args:
        recording: Recording of a shot.
        interval: s between frames.
        expected: Whether other recordings of the same camera lack frames. Contacts nearby are then no evidence against
            them: a ball is fitted over fewer frames, or ignored where no pause explains it.

    Returns:
        One jump per place of lost frames.
    """
    jumps: list[TimeJump] = []
    times = recording.t
    for _ in range(len(recording.t)):
        candidates = (_find_jump_after(recording, times, row, interval, expected) for row in range(len(times) - 1))
        best = max(candidates, key=lambda jump: jump.gain, default=None)
        if best is None or best.gain < _MIN_CHI2_GAIN or any(best.after == earlier.after for earlier in jumps):
            break
        jumps.append(best)
        times = add_pauses(recording.t, tuple(jumps), interval)
    return tuple(sorted(jumps, key=lambda jump: jump.after))


def add_pauses(t: FloatArray, jumps: tuple[TimeJump, ...], interval: float) -> FloatArray:
    """Convert presentation times (T,) into capture times by inserting the pauses of lost frames.

    Args:
        t: (T,) s.
        jumps: Lost frames.
        interval: s between frames.

    Returns:
        (T,) s.
    """
    taken = t.copy()
    for jump in jumps:
        taken[jump.after + 1 :] += jump.lost_frames * interval
    return taken


def _find_jump_after(recording: Recording, times: FloatArray, row: int, interval: float, expected: bool) -> TimeJump:
    """Find the pause after `row` that all moving balls together support best; its gain is 0 where there is none."""
    rows = np.arange(max(row - _FRAMES_PER_SIDE + 1, 0), min(row + _FRAMES_PER_SIDE + 1, len(times)))
    if row - rows[0] + 1 < _FRAMES_PER_SIDE - 1 or rows[-1] - row < _FRAMES_PER_SIDE - 1:
        return TimeJump(row, 0, 0.0)
    chi2, free = np.zeros(_MAX_LOST_FRAMES + 1), 0
    for ball, is_observed in enumerate(recording.is_observed[rows].T):
        observed_rows = rows[is_observed]
        before = int((observed_rows <= row).sum())
        if min(before, len(observed_rows) - before) < _MIN_FRAMES_PER_SIDE:
            continue
        t, xy = times[observed_rows], recording.positions[observed_rows, ball]
        sigma = recording.sigma[observed_rows, ball]
        for part in _list_row_ranges(before, len(observed_rows)) if expected else (slice(0, len(observed_rows)),):
            own_before, own_free = before - part.start, 2 * (part.stop - part.start) - 6
            if not _keeps_velocity(t[part], xy[part], own_before):
                continue
            own = _parabola_chi2(t[part], xy[part], sigma[part], own_before, interval)
            if not expected or own.min() <= _MAX_CHI2 * own_free:
                chi2 += own
                free += own_free
                break
    lost = int(np.argmin(chi2))
    if free == 0 or chi2[lost] > _MAX_CHI2 * free:
        return TimeJump(row, 0, 0.0)
    return TimeJump(row, lost, float(chi2[0] - chi2[lost]))


def _list_row_ranges(before: int, count: int) -> list[slice]:
    """List the ranges of samples on both sides of a pause that can be fitted, the longest first."""
    narrow = max(before - _MIN_FRAMES_PER_SIDE, 0), min(before + _MIN_FRAMES_PER_SIDE, count)
    parts = [slice(first, last) for first in (0, narrow[0]) for last in (count, narrow[1])]
    return sorted(parts, key=lambda part: part.start - part.stop)


def _keeps_velocity(t: FloatArray, xy: FloatArray, before: int) -> bool:
    """Return whether samples (n,) keep their velocity between the first `before` of them and the others."""
    one = (xy[before - 1] - xy[0]) / (t[before - 1] - t[0])
    two = (xy[-1] - xy[before]) / (t[-1] - t[before])
    return float(one @ two) > _MIN_VELOCITY_SHARE * max(float(one @ one), float(two @ two))


def _parabola_chi2(t: FloatArray, xy: FloatArray, sigma: FloatArray, before: int, interval: float) -> FloatArray:
    """Compute chi2 of parabolas through samples (n,) with a pause of 0, 1, ... lost frames after the first `before`."""
    lost_frames = np.arange(_MAX_LOST_FRAMES + 1)[:, None] * (np.arange(len(t)) >= before)
    times = (t - t[before - 1]) / interval + lost_frames
    basis = np.linalg.qr(np.stack([times**2, times, np.ones_like(times)], axis=2) / sigma[:, None])[0]
    target = xy / sigma[:, None]
    return np.asarray(np.square(target - basis @ (basis.swapaxes(1, 2) @ target)).sum(axis=(1, 2)))
