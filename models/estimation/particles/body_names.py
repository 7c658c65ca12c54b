"""Grouping of points by names that assign them to one body: box1-a, box1-b, box1-c."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import has_fixed_distances

MIN_POINTS = 3
"""Points that make a body."""


def group_by_name(ids: tuple[str, ...], x: FloatArray) -> IntArray | None:
    """Group points into rigid bodies by their names.

    Points belong together if their names agree up to the last - . or _, and their distances are constant. A single
    point is a body of its own.

    Args:
        ids: N names.
        x: (T, N, D) coordinates, NaN where a point was not observed.

    Returns:
        (N,) body of each point; None where no name assigns points to a common body.
    """
    stems = [re.split(r"[-._](?=[^-._]*$)", name)[0] for name in ids]
    counts = Counter(stems)
    labels = np.arange(len(ids))
    has_group = False
    for stem, count in counts.items():
        mine = np.array([one == stem for one in stems])
        if count >= MIN_POINTS and has_fixed_distances(x[:, mine]):
            labels[mine] = labels[mine][0]
            has_group = True
    return np.asarray(np.unique(labels, return_inverse=True)[1], np.int64) if has_group else None
