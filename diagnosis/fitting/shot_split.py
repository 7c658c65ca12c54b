"""Split of shots into fitting, selection and hold-out shots, by their order alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.recording import Recording

# Number of shots below which none is reserved for selection.
MIN_SHOTS_FOR_SELECTION = 6


@dataclass(frozen=True, slots=True)
class ShotSplit:
    """Recordings by their use; `holdout` must not be used before the verdict is final."""

    fitting: tuple[Recording, ...]
    """Shots that estimate parameters."""
    selection: tuple[Recording, ...]
    """Shots that confirm effects."""
    holdout: tuple[Recording, ...]
    """Shots on which the gap is reported."""


def split_shots(recordings: tuple[Recording, ...]) -> ShotSplit:
    """Split shots: half for fitting, a quarter for selection, a quarter for hold-out; few shots have no selection.

    Args:
        recordings: One recording per shot.

    Returns:
        The split.
    """
    ordered = tuple(sorted(recordings, key=lambda one: one.shot))
    if len(ordered) < MIN_SHOTS_FOR_SELECTION:
        fitting_count = len(ordered) if len(ordered) == 1 else len(ordered) - max(1, len(ordered) // 4)
        return ShotSplit(ordered[:fitting_count], (), ordered[fitting_count:])
    by_use: dict[str, list[Recording]] = {"fit": [], "select": [], "report": []}
    for place, one in enumerate(ordered):
        by_use[("fit", "select", "fit", "report")[place % 4]].append(one)
    return ShotSplit(*(tuple(by_use[use]) for use in ("fit", "select", "report")))


def find_common_duration(recordings: tuple[Recording, ...], total: float) -> float:
    """Find the duration to which recordings are shortened so that all together last no longer than `total`.

    Args:
        recordings: One recording per shot.
        total: s of all recordings together.

    Returns:
        s; infinite where nothing needs to be shortened.
    """
    durations = np.sort([one.t[-1] - one.t[0] for one in recordings])
    for k, duration in enumerate(durations):
        if duration * (len(durations) - k) >= total:
            return float(total / (len(durations) - k))
        total -= duration
    return float("inf")


def shorten_recordings(recordings: tuple[Recording, ...], duration: float) -> tuple[Recording, ...]:
    """Shorten recordings to their first `duration` s."""
    return tuple(one.select_rows(0, int(np.searchsorted(one.t, one.t[0] + duration, "right"))) for one in recordings)
