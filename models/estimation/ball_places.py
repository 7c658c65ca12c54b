"""Where every ball of a shot lay at one time, with the uncertainty of each place.

The balls on a table are matched with the places where they are wanted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.contact_test.shot_record import ShotRecord

# Standard deviations of the strike's time by which the default moment is before it.
STRIKE_SIGMAS = 3.0
# Probability from which an event is a strike.
MIN_STRIKE_PROBABILITY = 0.5
# s, from a moment to the observations of a ball that has no fitted path there. A ball that was placed or fell into a
# pocket within this time is rare; longer gaps would place balls that were taken from the table.
REACH_S = 0.5


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


# Kind of a ball whose class is unknown; it matches every kind.
ANY_KIND = "ball"
# CIE chroma distance from which colours count as entirely different: half the median distance between two of the eight
# colours of pool balls. Other light changes the colours of all balls alike.
DIFFERENT_COLOUR = 38.0


@dataclass(frozen=True, slots=True)
class _PlaceMatches:
    """M pairs of wanted places and present balls."""

    wanted: IntArray
    """(M,) indices of wanted places."""
    present: IntArray
    """(M,) indices of present balls."""


def match_places(
    wanted: tuple[tuple[str, ...], FloatArray, FloatArray],
    present: tuple[tuple[str, ...], FloatArray, FloatArray],
    diameter: float,
) -> _PlaceMatches:
    """Match present balls with wanted places by kind, colour and least total distance.

    Balls of different kinds match only where they overlap by place: there the class of one of them is wrong.

    Args:
        wanted: Kinds (N,), places (N, 2) m and colours (N, 3) CIE L*a*b* of the wanted places; NaN for an unknown
            colour.
        present: The same of the K present balls.
        diameter: m, of a ball.

    Returns:
        The pairs, in the order of the wanted places.
    """
    (kinds, xy, colour), (present_kinds, present_xy, present_colour) = wanted, present
    distance = np.linalg.norm(xy[:, None] - present_xy[None], axis=2)
    farthest = float(distance.max(initial=diameter)) + diameter
    chroma = np.linalg.norm(colour[:, None, 1:] - present_colour[None, :, 1:], axis=2)
    differs = np.array([[ANY_KIND not in (a, b) and a != b for b in present_kinds] for a in kinds], bool)
    differs = differs.reshape(distance.shape)
    colour_cost = np.clip(np.nan_to_num(chroma) / DIFFERENT_COLOUR, 0.0, 1.0) * farthest
    # A pair of different kinds costs more than any rearrangement of pairs of equal kinds.
    cost = distance + colour_cost + differs * 2.0 * farthest * (1 + min(distance.shape, default=0))
    rows, columns = linear_sum_assignment(cost)
    is_pair = ~differs[rows, columns] | (distance[rows, columns] <= diameter)
    return _PlaceMatches(rows[is_pair].astype(np.int64), columns[is_pair].astype(np.int64))
