"""Observations of bodies at rest in recordings that contain only those samples in which something moved.

A window starts from the places of all bodies. A recorder that stores a sample only after a body has moved leaves out a
body at rest for seconds; its place is known nevertheless, from the samples before and after.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray

# m/s: mean speed between two samples up to which a body rests in between, but for its last steps.
_REST_SPEED = 0.01
# Rows at the start of a window in which a body at rest is observed: as many as show that it rests.
_ROWS = 2


def add_rest_observations(segment: Recording, firsts: IntArray) -> Recording:
    """Add observations of bodies that rest in the first rows of a window and have no sample there.

    They repeat other samples; all that are added for a body have together the information of one.

    Args:
        segment: Segment of a recording.
        firsts: First row of each window, and the row after the last one.

    Returns:
        The segment with these observations; the same one where there are none.
    """
    positions, sigma = segment.positions.copy(), segment.sigma.copy()
    for body in range(len(segment.bodies)):
        rows = np.flatnonzero(segment.is_observed[:, body])
        empty = [row for row in (firsts[:-1, None] + np.arange(_ROWS)).flat if not segment.is_observed[row, body]]
        sources = {int(row): _find_rest_sample(segment, body, rows, int(row)) for row in empty}
        sources = {row: source for row, source in sources.items() if source >= 0}
        for row, source in sources.items():
            positions[row, body] = segment.positions[source, body]
            sigma[row, body] = segment.sigma[source, body] * np.sqrt(len(sources))
    return replace(segment, positions=positions, sigma=sigma)


def _find_rest_sample(segment: Recording, body: int, rows: IntArray, first: int) -> int:
    """Find the sample, of those at `rows`, that shows where a body rests at row `first`; -1 where it may move."""
    after = int(np.searchsorted(rows, first))
    if after == 0:
        return -1
    is_still = after == 1 or _mean_speed(segment, body, rows[after - 2 : after]) < _REST_SPEED
    if after == len(rows):
        return int(rows[-1]) if is_still else -1
    if not _mean_speed(segment, body, rows[after - 1 : after + 1]) < _REST_SPEED:
        return -1
    return int(rows[after - 1] if is_still else rows[after])


def _mean_speed(segment: Recording, body: int, rows: IntArray) -> float:
    """Compute the mean speed (m/s) of a body between two rows."""
    way: FloatArray = segment.positions[rows[1], body] - segment.positions[rows[0], body]
    return float(np.linalg.norm(way) / (segment.t[rows[1]] - segment.t[rows[0]]))
