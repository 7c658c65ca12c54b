"""What a picture makes of a place on the table where the calibration is not quite right: scale, lens and perspective.

With d the place from the middle of the picture in half lengths of the table: e = d / (1 + p . d), and it is seen at
s (1 + k1 |e|^2 + k2 |e|^4) e. Times differ too: lower rows may be taken later (`rolling_shutter`), and pictures may be
missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

ON_PICTURE = ("lens_distortion.k1", "perspective.p_x", "perspective.p_y", "scale.seen", "lens_second_term.k2")
"""Numbers that move what is seen."""
FAITHFUL = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""(5,) of a calibration that is right."""


@dataclass(frozen=True, slots=True)
class View:
    """Where a picture lies on the table."""

    middle: FloatArray
    """(2,) m, of the picture."""
    half: float
    """m, half the length of the table: the unit of the lens."""
    height: float = 1.0
    """m, of the picture: a row is a share of it, counted from its middle."""

    def rows(self, xy: FloatArray) -> FloatArray:
        """(...) rows in which places (..., 2) are seen."""
        found: FloatArray = (xy[..., 1] - self.middle[1]) / self.height
        return found


def seen(view: View, xy: FloatArray, numbers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where places (..., 2) are seen, m, with `numbers` (5,) as in `ON_PICTURE`; its derivatives (..., 2, 2) by the
    place and (..., 2, 5) by the numbers."""
    k1, p, scale, k2 = numbers[0], numbers[1:3], numbers[3], numbers[4]
    d = (xy - view.middle) / view.half
    q = (1 / (1 + d @ p))[..., None]
    e = d * q
    size = np.sum(e * e, axis=-1)[..., None]
    stretched = 1 + (k1 + k2 * size) * size
    shown = stretched * e
    bent = stretched[..., None] * np.eye(2)
    bent += (2 * k1 + 4 * k2 * size)[..., None] * e[..., :, None] * e[..., None, :]
    turned = q[..., None] * np.eye(2) - (q**2)[..., None] * d[..., :, None] * p
    by_place = scale * bent @ turned
    by_p = -scale * bent @ (q**2 * d)[..., :, None] * d[..., None, :]
    by_lens = scale * np.stack([size * e, size**2 * e], axis=-1)
    by_numbers = np.concatenate([by_lens[..., :1], by_p, shown[..., None], by_lens[..., 1:]], axis=-1)
    return view.middle + view.half * scale * shown, by_place, view.half * by_numbers
