"""Points whose names say that they are fixed to one body: box1-a, box1-b, box1-c."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import keep_their_distances

LEAST = 3
"""points that make a body."""


def named_bodies(ids: tuple[str, ...], x: FloatArray) -> IntArray | None:
    """(N,) bodies of points x (T, N, D): those that share a name up to its last - . or _, and keep their distances.

    A point alone in its name is a body of its own. None where no name says anything.
    """
    stems = [re.split(r"[-._](?=[^-._]*$)", name)[0] for name in ids]
    counts = Counter(stems)
    labels = np.arange(len(ids))
    found = False
    for stem, count in counts.items():
        mine = np.array([one == stem for one in stems])
        if count >= LEAST and keep_their_distances(x[:, mine]):
            labels[mine] = labels[mine][0]
            found = True
    return np.asarray(np.unique(labels, return_inverse=True)[1], np.int64) if found else None
