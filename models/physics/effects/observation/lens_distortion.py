"""Radial lens distortion of third order: r_seen = r (1 + k1 r^2); k1 > 0 is a pincushion.

r is the distance from the image centre in half table lengths.

The code of the equation is in `models.physics.billiards.simulation.parametrised_shot.distort_places`.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="lens_distortion",
    kind="observation",
    site="camera",
    phases=("image_region",),
    parameters=(Prior("k1", "1", value=0.0, sigma=0.02, relative=False, bounds=(-0.3, 0.3)),),
    neutral=(0.0,),
    partners=("scale", "unequal_radius"),
    reference="Brown 1971, Close-range camera calibration, Photogrammetric Engineering 37: the first radial term",
    rank=17,
)
