"""A streak as a network is shown it: turned level, its way and the ball's width to the same number of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.network.image_patches import patch
from models.core.typing import ByteArray, FloatArray

ROWS, COLUMNS = 40, 80
RADIUS_PX = 9.0
"""Of a ball, across the streak, px of the straightened picture."""
MARGIN_RADII = 2.2
"""What is shown beyond the middle of a ball at either end, ball radii; across it follows from ROWS and RADIUS_PX."""


@dataclass(frozen=True, slots=True)
class Straight:
    """How one streak is shown."""

    centre: FloatArray
    """(2,) px that come to the middle."""
    radius: float
    """px, of the ball."""
    way: FloatArray
    """(2,) px travelled, longer than nothing, sign unknown."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors along the streak and across it (2, 2), rows."""
        along = self.way / np.linalg.norm(self.way)
        return np.array([along, [-along[1], along[0]]])

    def picture(self, rgb: ByteArray) -> ByteArray:
        """What (ROWS, COLUMNS, 3) is shown of a picture (H, W, 3); beyond its border the border goes on."""
        length = float(np.linalg.norm(self.way))
        ahead = COLUMNS / 2 / (length / 2 + MARGIN_RADII * self.radius)
        beside = RADIUS_PX / self.radius
        linear = np.array([[ahead], [beside]]) * self.axes
        reach = length / 2 + (MARGIN_RADII + ROWS / 2 / RADIUS_PX) * self.radius
        return patch(rgb, self.centre, linear, (COLUMNS, ROWS), reach, beside)

    def told(self, centre: FloatArray, way: FloatArray) -> FloatArray:
        """What (4,) says that a streak with another centre and way, px, is here: `moved` undoes it.

        Its centre along and across this one, by how much its way is longer along and leads aside, ball radii.
        """
        same = way if way @ self.way >= 0 else -way
        return np.concatenate([self.axes @ (centre - self.centre), self.axes @ (same - self.way)]) / self.radius

    def moved(self, told: FloatArray) -> Straight:
        """The streak that (4,) as of `told` speaks of."""
        off = self.radius * np.asarray(told).reshape(2, 2) @ self.axes
        return Straight(self.centre + off[0], self.radius, self.way + off[1])
