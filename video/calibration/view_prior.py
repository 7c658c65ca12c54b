"""What earlier clips of a camera that stands still say about the table in the next clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import BallSize, Table
from models.core.typing import FloatArray
from models.numerics.statistics import measure_contradiction

# First words of the note about a moving camera.
MOTION_NOTE = "the camera moves"
# Start of the notes about a profile of which something does not fit.
PROFILE_NOTE = "table profile:"
# Note about a profile of another cloth.
CLOTH_MISFIT = f"{PROFILE_NOTE} the cloth has another colour than in it; its friction is not used"
# Probability of a larger difference below which two estimates of the corners, or of the cloth, are of different views:
# a fitting profile is refused once in a thousand clips.
MIN_AGREEMENT = 1e-3
# CIE L*a*b* units of a* and b*, by which white balance and lamps change the colour of one cloth between clips: gains of
# 12 % of the three channels, as the training images assume, change usual cloths by 3.8 (root mean square).
CLOTH_SIGMA = 4.0


@dataclass(frozen=True, slots=True)
class ViewPrior:
    """Table, corners and colours as earlier clips showed them."""

    table: Table
    ball_size: BallSize
    """Radius of the balls."""
    corners: FloatArray | None
    """(4, 2) px, in the order of `Table.corners`; None if the profile holds no view."""
    covariance: FloatArray | None
    """(8, 8) px^2."""
    image_size: tuple[int, int]
    """Width and height, px, of the image with these corners."""
    cloth_lab: FloatArray | None
    """(3,) CIE L*a*b*; None if unknown."""
    shot_count: int
    """Number of shots that the view comes from."""

    def agrees_with_corners(self, corners: FloatArray, covariance: FloatArray) -> bool:
        """Return whether located corners (4, 2) px with their covariance (8, 8) are those of this view."""
        if self.corners is None or self.covariance is None:
            return False
        own, other = (self.corners.ravel(), self.covariance), (corners.ravel(), covariance)
        return measure_contradiction(own, other) >= MIN_AGREEMENT

    def agrees_with_cloth(self, lab: FloatArray) -> bool:
        """Return whether a cloth of colour (3,) CIE L*a*b* may be the same; its lightness may differ."""
        if self.cloth_lab is None:
            return True
        variance = 2 * CLOTH_SIGMA**2 * np.eye(2)
        return measure_contradiction((self.cloth_lab[1:], variance), (lab[1:], 0 * variance)) >= MIN_AGREEMENT
