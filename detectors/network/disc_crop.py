"""A ball at rest as a network is shown it: brought to one size, as it stands in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.network.image_patches import patch
from models.core.typing import ByteArray, FloatArray

SIDE = 40
RADIUS_PX = 10.0
"""Of a ball, px of what is shown."""


@dataclass(frozen=True, slots=True)
class Upright:
    """How one ball is shown."""

    centre: FloatArray
    """(2,) px that come to the middle."""
    radius: float
    """px, of a ball there."""
    turn: float = 0.0
    """rad by which the picture is turned: cameras stand level but for a little."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors (2, 2), rows, to the right and down of what is shown."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cosine, -sine], [sine, cosine]])

    def picture(self, rgb: ByteArray) -> ByteArray:
        """What (SIDE, SIDE, 3) is shown of a picture (H, W, 3); beyond its border the border goes on."""
        zoom = RADIUS_PX / self.radius
        return patch(rgb, self.centre, zoom * self.axes, (SIDE, SIDE), SIDE / zoom, zoom)

    def told(self, centre: FloatArray) -> FloatArray:
        """Where (2,) a centre, px, lies here, ball radii: `moved` undoes it."""
        return np.asarray(self.axes @ (centre - self.centre) / self.radius)

    def moved(self, told: FloatArray) -> Upright:
        """The ball that (2,) as of `told` speaks of."""
        return Upright(self.centre + self.radius * told @ self.axes, self.radius, self.turn)
