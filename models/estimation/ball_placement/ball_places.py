"""Where every ball of a shot lay at one time, with the uncertainty of each place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.contact_test.shot_record import ShotRecord

STRIKE_SIGMAS = 3.0
"""Standard deviations of the strike's time by which the default moment is before it."""
MIN_STRIKE_PROBABILITY = 0.5
"""Probability from which an event is a strike."""
REACH_S = 0.5
"""s, from a moment to the observations of a ball that has no fitted path there. A ball that was placed or fell into a
pocket within this time is rare; longer gaps would place balls that were taken from the table."""


@dataclass(frozen=True, slots=True)
class BallPlaces:
    """Places of N balls at one time."""

    t: float
    """s, presentation time."""
    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    xy: FloatArray
    """(N, 2) m, centres."""
    sigma: FloatArray
    """(N,) m, standard deviation of the measurement per axis, without that of the calibration."""
    speed: FloatArray
    """(N,) m/s; 0 at rest."""
    absent: tuple[str, ...] = ()
    """Balls of the shot that were not on the table."""


def select_moment_before_strike(record: ShotRecord) -> float:
    """Select the moment just before the first strike.

    Args:
        record: A shot.

    Returns:
        s, `STRIKE_SIGMAS` standard deviations before the strike, not before the first frame; the time of the first
        frame where no strike was found.
    """
    events, first = record.events, float(record.shown[0])
    strikes = [
        float(t - STRIKE_SIGMAS * sigma)
        for kind, t, sigma, p in zip(events.kind, events.t, events.t_sigma, events.probability, strict=True)
        if kind == "strike" and p >= MIN_STRIKE_PROBABILITY
    ]
    return max(min(strikes, default=first), first)


def locate_balls(record: ShotRecord, t: float) -> BallPlaces:
    """Locate every ball of a shot at one time.

    A place is that of the fitted path, for a ball at rest the mean over all frames of the rest. Where a path has a gap,
    it is the median of the observations within `REACH_S`.

    Args:
        record: The shot.
        t: s, presentation time within the shot.

    Returns:
        The balls on the table, and the names of the absent ones.
    """
    moment = int(np.argmin(np.abs(record.moments - t)))
    ids, kinds, rows, absent = [], [], [], []
    for k, (name, kind) in enumerate(zip(record.ids, record.kinds, strict=True)):
        xy, sigma, speed = record.path[moment, k], float(record.path_sigma[moment, k]), record.speed_at(k, t)
        if not np.isfinite(xy).all():
            near = (record.ball == k) & (np.abs(record.t - t) <= REACH_S)
            if not near.any():
                absent.append(name)
                continue
            xy, sigma, speed = np.median(record.xy[near], axis=0), float(np.median(record.sigma[near])), np.nan
        ids.append(name)
        kinds.append(kind)
        rows.append([*xy, sigma, speed])
    table = np.array(rows).reshape(-1, 4)
    return BallPlaces(t, tuple(ids), tuple(kinds), table[:, :2], table[:, 2], table[:, 3], tuple(absent))


def measure_cushion_distances(table: Table, xy: FloatArray) -> FloatArray:
    """Measure the distances of centres to the four noses.

    Args:
        table: The table.
        xy: Centres (N, 2), m.

    Returns:
        Distances (N, 4), m, in the order of `CUSHIONS`: left, right, top, bottom.
    """
    return np.column_stack([xy[:, 0], table.length - xy[:, 0], xy[:, 1], table.width - xy[:, 1]])


def find_nearest_cushions(distances: FloatArray) -> tuple[int, int]:
    """Find the nearer one of the two short cushions, and of the two long ones.

    Args:
        distances: Distances (4,) of a ball to the noses, in the order of `CUSHIONS`.

    Returns:
        Their indices in `CUSHIONS`.
    """
    return int(np.argmin(distances[:2])), 2 + int(np.argmin(distances[2:]))
