"""Pictures that are missing in a recording without a trace in its times: everything that moves jumps ahead at once.

A ball that jumps ahead keeps its direction and its speed, which no contact does. So around every picture the paths of
all moving balls are fitted by parabolas in a time that pauses for 0, 1, 2, ... pictures; the pause that explains them
wins where it explains them well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray

_SIDE = 6
"""pictures on either side: a parabola holds over twice as many."""
_NARROW = 4
"""the fewest, on a side where a contact is near."""
_MOST = 15
"""pictures lost at once."""
_GAIN = 40.0
"""chi2 that a pause must explain."""
_FIT = 3.0
"""chi2 per degree of freedom up to which it explains."""
_KEPT = 0.4
"""share of the larger of two velocities that the smaller one keeps along it: a strike or a contact keeps less."""


@dataclass(frozen=True, slots=True)
class TimeJump:
    """Pictures lost after one picture."""

    after: int
    """row of `Tracks` after which they are missing."""
    lost: int
    """how many."""
    gain: float
    """chi2 that they explain."""


def time_jumps(tracks: Tracks, interval: float, scale: float = 1.0, expected: bool = False) -> tuple[TimeJump, ...]:
    """Lost pictures, in the order of time; `interval` is s between pictures, `scale` a factor on the tracks' sigmas.

    Where they are `expected`, for other recordings of the same camera lack some, contacts nearby are no reason against
    them: a ball is looked at over fewer pictures, or left out where no pause explains it.
    """
    found: list[TimeJump] = []
    times = tracks.t
    for _ in range(len(tracks.t)):
        best = max((_jump_after(tracks, times, row, interval, scale, expected) for row in range(len(times) - 1)),
                   key=lambda jump: jump.gain, default=None)  # fmt: skip
        if best is None or best.gain < _GAIN or any(best.after == known.after for known in found):
            break
        found.append(best)
        times = with_pauses(tracks.t, tuple(found), interval)
    return tuple(sorted(found, key=lambda jump: jump.after))


def with_pauses(t: FloatArray, jumps: tuple[TimeJump, ...], interval: float) -> FloatArray:
    """Times (T,) as they were when the pictures were taken."""
    taken = t.copy()
    for jump in jumps:
        taken[jump.after + 1 :] += jump.lost * interval
    return taken


def _jump_after(tracks: Tracks, times: FloatArray, row: int, interval: float, scale: float, expected: bool) -> TimeJump:
    """The pause after `row` that all moving balls together support best; no gain where none does."""
    rows = np.arange(max(row - _SIDE + 1, 0), min(row + _SIDE + 1, len(times)))
    if row - rows[0] + 1 < _SIDE - 1 or rows[-1] - row < _SIDE - 1:
        return TimeJump(row, 0, 0.0)
    chi2, free = np.zeros(_MOST + 1), 0
    for ball in range(len(tracks.ids)):
        seen = rows[tracks.observed[rows, ball]]
        before = int((seen <= row).sum())
        if min(before, len(seen) - before) < _NARROW:
            continue
        t, xy, sigma = times[seen], tracks.xy[seen, ball], scale * tracks.sigma[seen, ball]
        for part in _parts(before, len(seen)) if expected else (slice(0, len(seen)),):
            own_before, own_free = before - part.start, 2 * (part.stop - part.start) - 6
            if not _goes_on(t[part], xy[part], own_before):
                continue
            own = _misfits(t[part], xy[part], sigma[part], own_before, interval)
            if not expected or own.min() <= _FIT * own_free:
                chi2 += own
                free += own_free
                break
    lost = int(np.argmin(chi2))
    if free == 0 or chi2[lost] > _FIT * free:
        return TimeJump(row, 0, 0.0)
    return TimeJump(row, lost, float(chi2[0] - chi2[lost]))


def _parts(before: int, count: int) -> list[slice]:
    """Parts of so many samples on both sides of a pause, the longest first."""
    narrow = max(before - _NARROW, 0), min(before + _NARROW, count)
    parts = [slice(first, last) for first in (0, narrow[0]) for last in (count, narrow[1])]
    return sorted(parts, key=lambda part: part.start - part.stop)


def _goes_on(t: FloatArray, xy: FloatArray, before: int) -> bool:
    """Whether samples (n,) move alike in the first `before` of them and afterwards."""
    one = (xy[before - 1] - xy[0]) / (t[before - 1] - t[0])
    two = (xy[-1] - xy[before]) / (t[-1] - t[before])
    return float(one @ two) > _KEPT * max(float(one @ one), float(two @ two))


def _misfits(t: FloatArray, xy: FloatArray, sigma: FloatArray, before: int, interval: float) -> FloatArray:
    """chi2 (0 .. _MOST lost) of a parabola through samples (n,), of which `before` come before the pause."""
    found = np.empty(_MOST + 1)
    for lost in range(_MOST + 1):
        s = t - t[before - 1] + np.where(np.arange(len(t)) >= before, lost * interval, 0.0)
        design = np.vander(s / interval, 3) / sigma[:, None]
        seen = xy / sigma[:, None]
        solved = np.linalg.lstsq(design, seen, rcond=None)[0]
        found[lost] = float(((seen - design @ solved) ** 2).sum())
    return found
