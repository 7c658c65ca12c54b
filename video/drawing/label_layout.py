"""Where labels and panels go: beside what they name, and over as little as can be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.numerics.jit import compiled

Rect = tuple[float, float, float, float]
"""left, top, width, height in px."""

ANGLES = np.deg2rad([-45.0, -135.0, 45.0, 135.0, -90.0, 90.0, 0.0, 180.0])
"""Directions from a ball to its label, the liked ones first; clockwise from right."""
GAPS = (0.7, 2.2)
"""Distances of a label from the edge of its ball, in radii."""
WAY_COST, STAY_COST, FAR_COST, RANK_COST = 0.5, 0.5, 0.15, 0.02
"""Of a label on its ball's way, of going to the other side, of the larger gap, of each less liked direction; a label
that is covered wholly costs 2, one that is outside the picture 8."""
SIDES = np.column_stack([np.tile(ANGLES, len(GAPS)), np.repeat(GAPS, len(ANGLES))])
RANKS = RANK_COST * np.tile(np.arange(len(ANGLES)), len(GAPS))
"""All sides, (16, 2) rad and radii, and what their rank costs."""
PANEL_PLACES = ((0, 1), (1, 1), (0, 0), (1, 0), (0.5, 1), (0.5, 0), (0, 0.5), (1, 0.5))
"""Shares of the way from left to right and from top to bottom."""
MIDDLE_COST = 0.2
"""Of a panel that stands in no corner, in the unit of the map."""
PANEL_MARGIN = 0.022
"""Between panels and the border of the picture, share of its height."""


def overlap(a: Rect, b: Rect) -> float:
    """Shared area, px^2."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)


_overlap = compiled(overlap)


def covered_share(rect: Rect, taken: Sequence[Rect]) -> float:
    """Area of a rectangle over taken ones, share of its own; what is taken twice counts twice."""
    return sum(overlap(rect, other) for other in taken) / (rect[2] * rect[3])


@dataclass(frozen=True, slots=True)
class Side:
    """Where a label stands beside its ball: a direction, rad clockwise from right, and a gap in radii."""

    angle: float
    gap: float

    def corner(self, size: tuple[int, int], radius: float) -> FloatArray:
        """Top-left corner (2,) of a box of `size` (w, h) relative to the ball's centre, px; continuous in both."""
        return np.array(_corner(self.angle, self.gap, float(size[0]), float(size[1]), radius))

    def towards(self, other: Side, share: float) -> Side:
        """A `share` of the way round the ball to another side."""
        turn = (other.angle - self.angle + np.pi) % (2 * np.pi) - np.pi
        return Side(self.angle + share * turn, self.gap + share * (other.gap - self.gap))


def place_label(
    size: tuple[int, int],
    centre: FloatArray,
    radius: float,
    heading: FloatArray,
    taken: Sequence[Rect],
    bounds: tuple[int, int],
    previous: Side | None,
) -> Side:
    """The side of a ball where a label of `size` (w, h) covers little that is taken and is off the ball's way.

    `heading` (2,) is the direction of motion, zero at rest; `bounds` the picture's (w, h); `previous` where it was.
    """
    box = float(size[0]), float(size[1])
    others = np.array(taken, dtype=np.float64).reshape(-1, 4)
    stood = math.nan if previous is None else previous.angle
    angle, gap = SIDES[_cheapest(box, centre, radius, heading, others, (float(bounds[0]), float(bounds[1])), stood)]
    return Side(float(angle), float(gap))


@compiled
def _cheapest(
    size: tuple[float, float],
    centre: FloatArray,
    radius: float,
    heading: FloatArray,
    taken: FloatArray,
    bounds: tuple[float, float],
    stood: float,
) -> int:
    """Which of `SIDES` costs least; `taken` (n, 4) are rectangles, `stood` is the angle where the label was, or NaN."""
    best, least, area = 0, np.inf, size[0] * size[1]
    for k in range(len(SIDES)):
        angle, gap = SIDES[k]
        left, top = _corner(angle, gap, size[0], size[1], radius)
        rect = (left + centre[0], top + centre[1], size[0], size[1])
        covered = 0.0
        for m in range(len(taken)):
            covered += _overlap(rect, (taken[m, 0], taken[m, 1], taken[m, 2], taken[m, 3]))
        outside = area - _overlap(rect, (0.0, 0.0, bounds[0], bounds[1]))
        cost = (8 * outside + 2 * covered) / area + RANKS[k] + FAR_COST * (gap > GAPS[0])
        cost += WAY_COST * (math.cos(angle) * heading[0] + math.sin(angle) * heading[1]) ** 2
        if not math.isnan(stood):
            cost += STAY_COST * abs((angle - stood + math.pi) % (2 * math.pi) - math.pi) / math.pi
        if cost < least:
            best, least = k, cost
    return best


@compiled
def _corner(angle: float, gap: float, width: float, height: float, radius: float) -> tuple[float, float]:
    """Top-left corner of a box whose nearest point lies in a direction, at a gap in radii, from a ball at 0."""
    across, down, distance = math.cos(angle), math.sin(angle), radius * (1 + gap) + 2
    return across * distance - _near_side(across) * width, down * distance - _near_side(down) * height


@compiled
def _near_side(way: float) -> float:
    """Share of a box that lies on the near side of its middle, by one number of its direction."""
    return 0.5 - 0.5 * min(max(way * math.sqrt(2.0), -1.0), 1.0)


def place_panel(
    size: tuple[int, int], bounds: tuple[int, int], cost: FloatArray, taken: Sequence[Rect], scale: float
) -> Rect:
    """The place on the border of the picture, best a corner, where a panel hides least.

    `cost` (h, w) is a coarse map of the picture: what a hidden pixel costs; `scale` its pixels per pixel.
    """
    margin = PANEL_MARGIN * bounds[1]
    room = np.array(bounds) - 2 * margin - size
    best, least = (margin, margin, float(size[0]), float(size[1])), np.inf
    for u, v in PANEL_PLACES:
        rect = (float(margin + u * room[0]), float(margin + v * room[1]), float(size[0]), float(size[1]))
        x0, y0 = int(rect[0] * scale), int(rect[1] * scale)
        part = cost[y0 : y0 + max(1, int(size[1] * scale)), x0 : x0 + max(1, int(size[0] * scale))]
        hidden = (float(part.mean()) if part.size else np.inf) + MIDDLE_COST * (0.5 in (u, v))
        total = hidden + 100 * covered_share(rect, taken)
        if total < least:
            best, least = rect, total
    return best
