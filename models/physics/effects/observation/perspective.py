"""Perspective: the calibration missed a part of the angle between camera and table.

A place (x, y) relative to the image centre, in half table lengths, is measured at (x, y) / (1 + p_x x + p_y y). These
are the two parameters of the homography that are neither affine nor a shift.

The code of the equation is in `models.physics.billiards.simulation.parametrised_shot.distort_places`.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="perspective",
    kind="observation",
    site="camera",
    phases=("image_region",),
    parameters=(
        Prior("p_x", "1", value=0.0, sigma=0.01, relative=False, bounds=(-0.3, 0.3)),
        Prior("p_y", "1", value=0.0, sigma=0.01, relative=False, bounds=(-0.3, 0.3)),
    ),
    neutral=(0.0, 0.0),
    partners=("slope", "lens_distortion"),
    phrase="perspective of the camera",
    reference="Hartley and Zisserman 2004, Multiple View Geometry, section 2.4.3",
    rank=19,
)
