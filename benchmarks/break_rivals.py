"""Trackers that know nothing of billiards, as tracking kits have them, in their plainest form."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.typing import FloatArray, IntArray

PATIENCE = 15
"""Pictures that a track waits for its next detection."""
GATE = 0.3
"""m: farther detections are never joined to a track."""


def nearest(pictures: list[FloatArray]) -> list[IntArray]:
    """Track numbers of the detections (K, 2) m of every picture: each goes to the nearest last place, nearest first."""
    return _tracked(pictures, blend=0.0, greedy=True)


def constant_velocity(pictures: list[FloatArray]) -> list[IntArray]:
    """As SORT (Bewley 2016, doi:10.1109/ICIP.2016.7533003) does it: a filter of constant velocity, then Hungarian."""
    return _tracked(pictures, blend=0.6, greedy=False)


def _tracked(pictures: list[FloatArray], blend: float, greedy: bool) -> list[IntArray]:
    """`blend` is the share of a new velocity in the filtered one; 0 foresees no motion."""
    place, velocity, missed = np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64)
    names = []
    for seen in pictures:
        foreseen = place + velocity * (missed + 1)[:, None]
        apart = np.linalg.norm(foreseen[:, None] - seen[None], axis=2)
        apart[missed > PATIENCE] = np.inf
        rows, columns = _nearest_first(apart) if greedy else _cheapest(apart)
        name = np.full(len(seen), -1)
        name[columns] = rows
        step = (seen[columns] - place[rows]) / (missed[rows] + 1)[:, None]
        velocity[rows] = (1 - blend) * velocity[rows] + blend * step
        place[rows] = seen[columns]
        missed += 1
        missed[rows] = 0
        fresh = np.flatnonzero(name < 0)
        name[fresh] = len(place) + np.arange(len(fresh))
        place = np.concatenate([place, seen[fresh]])
        velocity = np.concatenate([velocity, np.zeros((len(fresh), 2))])
        missed = np.concatenate([missed, np.zeros(len(fresh), np.int64)])
        names.append(name)
    return names


def _cheapest(apart: FloatArray) -> tuple[IntArray, IntArray]:
    rows, columns = linear_sum_assignment(np.minimum(apart, 10 * GATE))
    near = apart[rows, columns] < GATE
    return rows[near], columns[near]


def _nearest_first(apart: FloatArray) -> tuple[IntArray, IntArray]:
    apart = apart.copy()
    found = []
    while apart.size and apart.min() < GATE:
        i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
        found.append((i, j))
        apart[i], apart[:, j] = np.inf, np.inf
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
