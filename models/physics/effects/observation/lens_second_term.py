"""Radial lens distortion of fifth order: r_seen = r (1 + k1 r^2 + k2 r^4), r as for `lens_distortion`.

Phones correct their lenses; the remaining distortion bends back at the edge of the image.

The code of the equation is in `models.physics.billiards.simulation.parametrised_shot.distort_places`.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="lens_second_term",
    kind="detail",
    site="camera",
    phases=("image_region",),
    parameters=(Prior("k2", "1", value=0.0, sigma=0.01, relative=False, bounds=(-0.3, 0.3)),),
    neutral=(0.0,),
    partners=("lens_distortion",),
    phrase="second term of the lens",
    reference="Brown 1971, Close-range camera calibration, Photogrammetric Engineering 37: the second radial term",
    rank=18,
)
