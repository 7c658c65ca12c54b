"""Where labels and panels go: beside what they name, and over as little as can be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rect = tuple[float, float, float, float]
"""left, top, width, height in px."""

ANGLES = np.deg2rad([-45.0, -135.0, 45.0, 135.0, -90.0, 90.0, 0.0, 180.0])
"""Directions from a ball to its label, the liked ones first; clockwise from right."""
WAY_COST, STAY_COST, RANK_COST = 0.6, 0.15, 0.02
"""Of a label ahead of or behind a moving ball, of leaving its place, of a less liked direction; covered is 2."""
PANEL_MARGIN = 0.022
"""Between panels and the border of the picture, share of its height."""


def overlap(a: Rect, b: Rect) -> float:
    """Shared area, px^2."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)


def place_label(
    size: tuple[int, int],
    centre: Floats,
    radius: float,
    heading: Floats,
    taken: Sequence[Rect],
    bounds: tuple[int, int],
    previous: Floats | None,
) -> Floats:
    """Top-left corner (2,) of a label of `size` (w, h) beside a ball: over little that is taken, off the ball's way.

    `heading` (2,) is the direction of motion, zero at rest; `bounds` the picture's (w, h); `previous` the corner
    relative to the ball that it had before.
    """
    best, least = np.zeros(2), np.inf
    area = float(size[0] * size[1])
    for rank, (gap, angle) in enumerate((gap, angle) for gap in (0.7, 2.0) for angle in ANGLES):
        corner = _corner(size, radius * (1 + gap) + 2, float(angle))
        place = centre + corner
        rect = (float(place[0]), float(place[1]), float(size[0]), float(size[1]))
        outside = area - overlap(rect, (0.0, 0.0, float(bounds[0]), float(bounds[1])))
        covered = sum(overlap(rect, other) for other in taken)
        middle = corner + np.array(size) / 2
        along = abs(float(middle @ heading)) / max(1e-9, float(np.linalg.norm(middle)))
        cost = (8 * outside + 2 * covered) / area + WAY_COST * along**2 + RANK_COST * rank
        if previous is not None:
            cost += STAY_COST * min(1.0, float(np.linalg.norm(corner - previous)) / (4 * radius))
        if cost < least:
            best, least = corner, cost
    return centre + best


def _corner(size: tuple[int, int], distance: float, angle: float) -> Floats:
    """Top-left corner of a box whose nearest point lies `distance` from the origin in a direction."""
    direction = np.array([np.cos(angle), np.sin(angle)])
    anchor = direction * distance
    share = np.where(np.abs(direction) < 0.3, 0.5, np.where(direction > 0, 0.0, 1.0))
    return np.asarray(anchor - share * np.array(size), dtype=np.float64)


def place_panel(
    size: tuple[int, int], bounds: tuple[int, int], cost: Floats, taken: Sequence[Rect], scale: float
) -> Rect:
    """The corner of the picture where a panel hides least.

    `cost` (h, w) is a coarse map of the picture: what a hidden pixel costs; `scale` its pixels per pixel.
    """
    margin = PANEL_MARGIN * bounds[1]
    lefts, tops = (margin, bounds[0] - margin - size[0]), (margin, bounds[1] - margin - size[1])
    best, least = (lefts[0], tops[0], float(size[0]), float(size[1])), np.inf
    for top in tops[::-1]:
        for left in lefts:
            rect = (float(left), float(top), float(size[0]), float(size[1]))
            x0, y0 = int(left * scale), int(top * scale)
            part = cost[y0 : y0 + max(1, int(size[1] * scale)), x0 : x0 + max(1, int(size[0] * scale))]
            hidden = float(part.mean()) if part.size else np.inf
            clash = sum(overlap(rect, other) for other in taken) / (size[0] * size[1])
            if hidden + 100 * clash < least:
                best, least = rect, hidden + 100 * clash
    return best
