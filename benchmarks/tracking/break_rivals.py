"""Simple trackers without billiards physics, as general tracking libraries have them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.typing import FloatArray, IntArray

# Frames that a track waits for its next detection.
PATIENCE = 15
# Largest distance between a track and its next detection, m.
GATE = 0.3


def track_nearest(frames: list[FloatArray]) -> list[IntArray]:
    """Track by nearest last position, nearest first; returns the track numbers of the detections (K, 2) m per frame."""
    return _track_detections(frames, blend=0.0, greedy=True)


def track_constant_velocity(frames: list[FloatArray]) -> list[IntArray]:
    """Track like SORT (Bewley 2016, doi:10.1109/ICIP.2016.7533003): constant velocity, Hungarian assignment."""
    return _track_detections(frames, blend=0.6, greedy=False)


def _track_detections(frames: list[FloatArray], blend: float, greedy: bool) -> list[IntArray]:
    """Track detections; `blend` is the share of a new velocity in the filtered one, 0 predicts no motion."""
    place, velocity, missed = np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64)
    names = []
    for detections in frames:
        predicted = place + velocity * (missed + 1)[:, None]
        apart = np.linalg.norm(predicted[:, None] - detections[None], axis=2)
        apart[missed > PATIENCE] = np.inf
        rows, columns = _assign_nearest(apart) if greedy else _assign_cheapest(apart)
        name = np.full(len(detections), -1)
        name[columns] = rows
        step = (detections[columns] - place[rows]) / (missed[rows] + 1)[:, None]
        velocity[rows] = (1 - blend) * velocity[rows] + blend * step
        place[rows] = detections[columns]
        missed += 1
        missed[rows] = 0
        fresh = np.flatnonzero(name < 0)
        name[fresh] = len(place) + np.arange(len(fresh))
        place = np.concatenate([place, detections[fresh]])
        velocity = np.concatenate([velocity, np.zeros((len(fresh), 2))])
        missed = np.concatenate([missed, np.zeros(len(fresh), np.int64)])
        names.append(name)
    return names


def _assign_cheapest(apart: FloatArray) -> tuple[IntArray, IntArray]:
    rows, columns = linear_sum_assignment(np.minimum(apart, 10 * GATE))
    near = apart[rows, columns] < GATE
    return rows[near], columns[near]


def _assign_nearest(apart: FloatArray) -> tuple[IntArray, IntArray]:
    apart = apart.copy()
    matches = []
    while apart.size and apart.min() < GATE:
        i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
        matches.append((i, j))
        apart[i], apart[:, j] = np.inf, np.inf
    pairs = np.array(matches, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
