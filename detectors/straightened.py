"""A streak as a network is shown it: turned level, its way and the ball's width to the same number of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

ROWS, COLUMNS = 40, 80
RADIUS_PX = 9.0
"""Of a ball, across the streak, px of the straightened picture."""
MARGIN_RADII = 2.2
"""What is shown beyond the middle of a ball at either end, ball radii; across it follows from ROWS and RADIUS_PX."""
LEAST_ZOOM = 0.7
"""Pictures that would be shrunk further are averaged over whole pixels first."""


@dataclass(frozen=True, slots=True)
class Straight:
    """How one streak is shown."""

    centre: Floats
    """(2,) px that come to the middle."""
    radius: float
    """px, of the ball."""
    way: Floats
    """(2,) px travelled, longer than nothing, sign unknown."""

    @property
    def axes(self) -> Floats:
        """Unit vectors along the streak and across it (2, 2), rows."""
        along = self.way / np.linalg.norm(self.way)
        return np.array([along, [-along[1], along[0]]])

    def picture(self, rgb: Bytes) -> Bytes:
        """What (ROWS, COLUMNS, 3) is shown of a picture (H, W, 3); beyond its border the border goes on."""
        length = float(np.linalg.norm(self.way))
        ahead = COLUMNS / 2 / (length / 2 + MARGIN_RADII * self.radius)
        beside = RADIUS_PX / self.radius
        linear = np.array([[ahead], [beside]]) * self.axes
        reach = length / 2 + (MARGIN_RADII + ROWS / 2 / RADIUS_PX) * self.radius
        part, shrunk, corner = _averaged(rgb, self.centre, reach, beside)
        # Px p of the picture are (p + 1/2 - corner) / shrunk - 1/2 of the part.
        shift = linear @ (0.5 * shrunk - 0.5 + corner - self.centre)
        middle = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2])
        matrix = np.column_stack([linear * shrunk, shift + middle])
        size, border = (COLUMNS, ROWS), cv2.BORDER_REPLICATE
        shown = cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR, borderMode=border)
        return np.asarray(shown, dtype=np.uint8)

    def told(self, centre: Floats, way: Floats) -> Floats:
        """What (4,) says that a streak with another centre and way, px, is here: `moved` undoes it.

        Its centre along and across this one, by how much its way is longer along and leads aside, ball radii.
        """
        same = way if way @ self.way >= 0 else -way
        return np.concatenate([self.axes @ (centre - self.centre), self.axes @ (same - self.way)]) / self.radius

    def moved(self, told: Floats) -> Straight:
        """The streak that (4,) as of `told` speaks of."""
        off = self.radius * np.asarray(told).reshape(2, 2) @ self.axes
        return Straight(self.centre + off[0], self.radius, self.way + off[1])


def _averaged(rgb: Bytes, centre: Floats, reach: float, zoom: float) -> tuple[Bytes, int, Floats]:
    """The part of a picture within a reach, averaged over squares of so many px where it will be shrunk; its corner."""
    squares = round(1 / zoom) if zoom < LEAST_ZOOM else 1
    if squares == 1:
        return rgb, 1, np.zeros(2)
    height, width = rgb.shape[:2]
    half = int(np.ceil(reach)) + 2 * squares
    x0, y0 = (int(np.clip(c - half, 0, side - squares)) for c, side in zip(centre, (width, height), strict=True))
    across = max(min(x0 + 2 * half + 1, width) - x0, squares) // squares
    down = max(min(y0 + 2 * half + 1, height) - y0, squares) // squares
    part = rgb[y0 : y0 + down * squares, x0 : x0 + across * squares]
    small = cv2.resize(part, (across, down), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), squares, np.array([x0, y0], dtype=np.float64)
