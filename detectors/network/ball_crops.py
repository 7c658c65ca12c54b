"""Crops of one ball in the form in which an offset regressor receives them.

A ball at rest is cropped as it stands in the image and scaled to one size. A motion-blur streak is turned level, and
its length and width are scaled to a fixed number of pixels each.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import ByteArray, FloatArray

# Zoom below which the image is first averaged over squares of whole pixels.
MIN_ZOOM = 0.7


def sample_patch(
    rgb: ByteArray, centre: FloatArray, linear: FloatArray, size: tuple[int, int], reach: float, zoom: float
) -> ByteArray:
    """Sample a patch of an image by a linear map.

    Args:
        rgb: Image (H, W, 3); its border is continued.
        centre: Px (2,) of the image at the middle of the patch.
        linear: Map (2, 2) from px of the image to px of the patch.
        size: Columns and rows of the patch.
        reach: Distance from the centre, px of the image, that the patch needs at most.
        zoom: Scale of the finer axis of `linear`, by which the averaging is chosen.

    Returns:
        The patch (rows, columns, 3).
    """
    part, shrunk, corner = _average_squares(rgb, centre, reach, zoom)
    # Px p of the image are (p + 1/2 - corner) / shrunk - 1/2 of the part.
    shift = linear @ (0.5 * shrunk - 0.5 + corner - centre)
    matrix = np.column_stack([linear * shrunk, shift + (np.array(size) - 1) / 2])
    shown = cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown, dtype=np.uint8)


def _average_squares(
    rgb: ByteArray, centre: FloatArray, reach: float, zoom: float
) -> tuple[ByteArray, int, FloatArray]:
    """Average the part of an image within a reach over squares; the part, the side of a square and its corner."""
    squares = round(1 / zoom) if zoom < MIN_ZOOM else 1
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


# Rows and columns of a disc crop.
DISC_SIDE = 40
# Radius of the ball in a disc crop.
DISC_RADIUS_PX = 10.0
# Rows and columns of a streak crop.
STREAK_ROWS, STREAK_COLUMNS = 40, 80
# Radius of the ball across the streak in a streak crop.
STREAK_RADIUS_PX = 9.0
# Length shown beyond the middle of the ball at either end, ball radii; the margin across the streak follows from
# STREAK_ROWS and STREAK_RADIUS_PX.
STREAK_MARGIN_RADII = 2.2


@dataclass(frozen=True, slots=True)
class DiscCrop:
    """Placement of the crop of one ball at rest."""

    centre: FloatArray
    """(2,) px of the image at the middle of the crop."""
    radius: float
    """px of the image, of a ball there."""
    roll: float = 0.0
    """rad by which the crop is turned; detection uses 0, training crops are turned to resemble tilted cameras."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors (2, 2), rows, to the right and down of the crop."""
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        return np.array([[cosine, -sine], [sine, cosine]])

    def sample(self, rgb: ByteArray) -> ByteArray:
        """Sample the crop (DISC_SIDE, DISC_SIDE, 3) from an image (H, W, 3); its border is continued."""
        zoom = DISC_RADIUS_PX / self.radius
        return sample_patch(rgb, self.centre, zoom * self.axes, (DISC_SIDE, DISC_SIDE), DISC_SIDE / zoom, zoom)

    def offset_to(self, centre: FloatArray) -> FloatArray:
        """Offset (2,), ball radii along the axes, of a centre (2,) px; `shift` is the inverse."""
        return np.asarray(self.axes @ (centre - self.centre) / self.radius)

    def shift(self, offset: FloatArray) -> DiscCrop:
        """The crop whose centre is at an offset (2,) as of `offset_to`."""
        return DiscCrop(self.centre + self.radius * offset @ self.axes, self.radius, self.roll)


@dataclass(frozen=True, slots=True)
class StreakCrop:
    """Placement of the crop of one motion-blur streak."""

    centre: FloatArray
    """(2,) px of the image at the middle of the crop."""
    radius: float
    """px of the image, of the ball."""
    displacement: FloatArray
    """(2,) px that the ball moved during the exposure, not zero, sign unknown."""

    @property
    def axes(self) -> FloatArray:
        """Unit vectors along the streak and across it (2, 2), rows."""
        along = self.displacement / np.linalg.norm(self.displacement)
        return np.array([along, [-along[1], along[0]]])

    def sample(self, rgb: ByteArray) -> ByteArray:
        """Sample the crop (STREAK_ROWS, STREAK_COLUMNS, 3) from an image (H, W, 3); its border is continued."""
        length = float(np.linalg.norm(self.displacement))
        zoom_along = STREAK_COLUMNS / 2 / (length / 2 + STREAK_MARGIN_RADII * self.radius)
        zoom_across = STREAK_RADIUS_PX / self.radius
        linear = np.array([[zoom_along], [zoom_across]]) * self.axes
        reach = length / 2 + (STREAK_MARGIN_RADII + STREAK_ROWS / 2 / STREAK_RADIUS_PX) * self.radius
        return sample_patch(rgb, self.centre, linear, (STREAK_COLUMNS, STREAK_ROWS), reach, zoom_across)

    def offset_to(self, centre: FloatArray, displacement: FloatArray) -> FloatArray:
        """Offset (4,), ball radii, of another centre and displacement (2,) px; `shift` is the inverse.

        The shift of the centre along and across this streak, then the change of the displacement along and across it.
        """
        same_way = displacement if displacement @ self.displacement >= 0 else -displacement
        shift, change = self.axes @ (centre - self.centre), self.axes @ (same_way - self.displacement)
        return np.concatenate([shift, change]) / self.radius

    def shift(self, offset: FloatArray) -> StreakCrop:
        """The crop of the streak at an offset (4,) as of `offset_to`."""
        shift, change = self.radius * np.asarray(offset).reshape(2, 2) @ self.axes
        return StreakCrop(self.centre + shift, self.radius, self.displacement + change)
