"""Placement of labels beside balls and of panels on the border of an image, hiding as little as possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

# left, top, width, height in px.
Rect = tuple[float, float, float, float]
# Rectangles to keep free, also as an array (n, 4).
Obstacles = Sequence[Rect] | FloatArray

# Directions from a ball to its label in order of preference, rad clockwise from right.
LABEL_ANGLES = np.deg2rad([-45.0, -135.0, 45.0, 135.0, -90.0, 90.0, 0.0, 180.0])
# Distances of a label from the edge of its ball, in ball radii.
LABEL_GAPS = (0.7, 2.2, 5.0)
# Costs of a label that covers anything or leaves the image, on its ball's path, of moving to the opposite side, of each
# larger gap, and of each step down in the order of preference. A fully covered label costs 2 more; one outside 8.
COVER_COST, ON_PATH_COST, MOVE_COST, FAR_COST, RANK_COST = 4.0, 0.5, 0.5, 0.15, 0.02
LABEL_POSITIONS = np.column_stack([np.tile(LABEL_ANGLES, len(LABEL_GAPS)), np.repeat(LABEL_GAPS, len(LABEL_ANGLES))])
# All candidate positions (24, 2), rad and radii, and the costs of their gap and rank (24,).
POSITION_COSTS = np.add.outer(FAR_COST * np.arange(len(LABEL_GAPS)), RANK_COST * np.arange(len(LABEL_ANGLES))).ravel()
# Candidate positions of a panel, as shares of the free width and of the free height.
PANEL_POSITIONS = ((0, 1), (1, 1), (0, 0), (1, 0), (0.5, 1), (0.5, 0), (0, 0.5), (1, 0.5))
# Cost of a panel outside the corners, in the unit of the cost map.
NO_CORNER_COST = 0.2
# px of the frame per cell of the panel cost map.
COST_CELL_PX = 8
# Margin between panels and the border of the image, share of the image height.
PANEL_MARGIN = 0.022


def overlap_share(rect: Rect, obstacles: Obstacles) -> float:
    """Return the share of a rectangle that obstacles cover.

    Args:
        rect: Rectangle, px.
        obstacles: Rectangles, px; an area that two of them cover counts twice.

    Returns:
        Covered area as a share of the rectangle's own area.
    """
    size = rect[2:]
    return float(_measure_overlaps(np.array([rect[:2]]), size, obstacles).sum() / np.prod(size))


def _measure_overlaps(corners: FloatArray, size: tuple[float, float], obstacles: Obstacles) -> FloatArray:
    """Measure the areas (n, m), px^2, that boxes of a size (w, h) at corners (n, 2) share with m obstacles."""
    left, top, width, height = np.asarray(obstacles, dtype=np.float64).reshape(-1, 4).T
    x, y = corners.T[:, :, None]
    across = np.minimum(x + size[0], left + width) - np.maximum(x, left)
    down = np.minimum(y + size[1], top + height) - np.maximum(y, top)
    return np.asarray(np.maximum(across, 0.0) * np.maximum(down, 0.0))


def make_squares(centres: FloatArray, half: FloatArray | float) -> FloatArray:
    """Return the squares (n, 4) px around points (n, 2) px that reach `half` px, a number or (n,); none at NaN."""
    size = np.broadcast_to(np.asarray(half, dtype=np.float64), len(centres))[:, None]
    squares = np.hstack([centres - size, 2 * size, 2 * size])
    return np.asarray(squares[np.isfinite(squares).all(axis=1)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class LabelPosition:
    """Position of a label relative to its ball: a direction, rad clockwise from right, and a gap in ball radii."""

    angle: float
    gap: float

    def top_left_corner(self, size: tuple[int, int], radius: float) -> FloatArray:
        """Return the top-left corner (2,) px of a box of `size` (w, h) px relative to the centre of its ball.

        The corner is continuous in the angle and in the gap.
        """
        return _find_corners(self.angle, self.gap, size, radius)

    def move_towards(self, other: LabelPosition, share: float) -> LabelPosition:
        """Return the position a `share` of the shorter way round the ball towards another position."""
        turn = (other.angle - self.angle + np.pi) % (2 * np.pi) - np.pi
        return LabelPosition(self.angle + share * turn, self.gap + share * (other.gap - self.gap))


def place_label(
    size: tuple[int, int],
    centre: FloatArray,
    radius: float,
    heading: FloatArray,
    obstacles: Obstacles,
    image_size: tuple[int, int],
    previous: LabelPosition | None,
) -> LabelPosition:
    """Choose the side of a ball where a label covers few obstacles and stays off the ball's path.

    Args:
        size: Width and height of the label, px.
        centre: Centre of the ball (2,), px.
        radius: Radius of the ball, px.
        heading: Direction of motion (2,), a unit vector in px; zero at rest.
        obstacles: Rectangles to keep free, px.
        image_size: Width and height of the image, px.
        previous: Position of the label on the frame before, which is preferred; None for a new label.

    Returns:
        The candidate position of least cost.
    """
    angle, gap = LABEL_POSITIONS.T
    corners, area = centre + _find_corners(angle, gap, size, radius), size[0] * size[1]
    covered = _measure_overlaps(corners, size, obstacles).sum(axis=1)
    outside = area - _measure_overlaps(corners, size, [(0.0, 0.0, *image_size)])[:, 0]
    cost = (8 * outside + 2 * covered) / area + POSITION_COSTS + COVER_COST * (covered + outside > 0)
    cost += ON_PATH_COST * (np.cos(angle) * heading[0] + np.sin(angle) * heading[1]) ** 2
    if previous is not None:
        cost += MOVE_COST * np.abs((angle - previous.angle + np.pi) % (2 * np.pi) - np.pi) / np.pi
    best = int(np.argmin(cost))
    return LabelPosition(float(angle[best]), float(gap[best]))


def _find_corners(
    angle: FloatArray | float, gap: FloatArray | float, size: tuple[int, int], radius: float
) -> FloatArray:
    """Find the top-left corners (..., 2) of boxes whose nearest point is at an angle and a gap, in radii, from a ball.

    The ball's centre is the origin.
    """
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    near_side = 0.5 - 0.5 * np.clip(way * np.sqrt(2.0), -1, 1)  # share of the box on the near side of its middle
    return np.asarray(way * (radius * (1 + np.asarray(gap)) + 2)[..., None] - near_side * size, dtype=np.float64)


def place_panel(
    size: tuple[int, int],
    image_size: tuple[int, int],
    cost_map: FloatArray,
    obstacles: Obstacles,
) -> Rect:
    """Choose the position on the border of the image, preferably a corner, where a panel hides least.

    Args:
        size: Width and height of the panel, px.
        image_size: Width and height of the image, px.
        cost_map: Coarse map of the image (h, w): cost of a hidden cell of `COST_CELL_PX`.
        obstacles: Rectangles that must stay free, px.

    Returns:
        The rectangle of the panel, px.
    """
    margin = PANEL_MARGIN * image_size[1]
    free_space = np.array(image_size) - 2 * margin - size
    best, least = (margin, margin, float(size[0]), float(size[1])), np.inf
    for u, v in PANEL_POSITIONS:
        rect = (float(margin + u * free_space[0]), float(margin + v * free_space[1]), float(size[0]), float(size[1]))
        x0, y0, columns, rows = (int(side / COST_CELL_PX) for side in rect)
        part = cost_map[y0 : y0 + max(1, rows), x0 : x0 + max(1, columns)]
        hidden = (float(part.mean()) if part.size else np.inf) + NO_CORNER_COST * (0.5 in (u, v))
        total = hidden + 100 * overlap_share(rect, obstacles)
        if total < least:
            best, least = rect, total
    return best
