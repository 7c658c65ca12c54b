"""Effects of an imperfect calibration on measured places: scale, lens distortion and perspective.

With d the place relative to the image centre in half table lengths and e = d / (1 + p . d), a place is measured at
s (1 + k1 |e|^2 + k2 |e|^4) e. Effects on the times of frames (`rolling_shutter`, `dropped_frames`) are applied
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

# Parameters that move measured places.
IMAGE_PARAMETERS = ("lens_distortion.k1", "perspective.p_x", "perspective.p_y", "scale.seen", "lens_second_term.k2")
# (5,) values of a perfect calibration.
NEUTRAL_IMAGE_PARAMETERS = np.array([0.0, 0.0, 0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class ImagePlacement:
    """Position of the image on the table."""

    centre: FloatArray
    """(2,) m, image centre."""
    half_length: float
    """m, half the length of the table: the unit of the lens."""
    height: float = 1.0
    """m, of the image on the table."""

    def image_rows(self, xy: FloatArray) -> FloatArray:
        """Compute the image rows of places.

        Args:
            xy: (..., 2) places, m.

        Returns:
            (...) rows relative to the image centre, as a part of the image height.
        """
        rows: FloatArray = (xy[..., 1] - self.centre[1]) / self.height
        return rows


def distort_places(
    placement: ImagePlacement, xy: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute where places are measured, and the derivatives.

    Args:
        placement: Position of the image on the table.
        xy: (..., 2) places, m.
        parameters: (5,) values of `IMAGE_PARAMETERS`.

    Returns:
        Measured places (..., 2), m; their derivatives (..., 2, 2) by the place and (..., 2, 5) by the parameters.
    """
    k1, p, scale, k2 = parameters[0], parameters[1:3], parameters[3], parameters[4]
    place = (xy - placement.centre) / placement.half_length
    foreshortening = (1 / (1 + place @ p))[..., None]
    projected = place * foreshortening
    radius_squared = np.sum(projected * projected, axis=-1)[..., None]
    magnification = 1 + (k1 + k2 * radius_squared) * radius_squared
    distorted = magnification * projected
    lens_jacobian = magnification[..., None] * np.eye(2)
    lens_jacobian += (2 * k1 + 4 * k2 * radius_squared)[..., None] * projected[..., :, None] * projected[..., None, :]
    perspective_jacobian = (
        foreshortening[..., None] * np.eye(2) - (foreshortening**2)[..., None] * place[..., :, None] * p
    )
    by_place = scale * lens_jacobian @ perspective_jacobian
    by_p = -scale * lens_jacobian @ (foreshortening**2 * place)[..., :, None] * place[..., None, :]
    by_lens = scale * np.stack([radius_squared * projected, radius_squared**2 * projected], axis=-1)
    by_numbers = np.concatenate([by_lens[..., :1], by_p, distorted[..., None], by_lens[..., 1:]], axis=-1)
    return placement.centre + placement.half_length * scale * distorted, by_place, placement.half_length * by_numbers
