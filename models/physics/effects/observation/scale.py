"""Scale: measured lengths over true lengths, the same factor in all directions from the image centre.

The code of the equation is in `models.physics.billiards.simulation.parametrised_shot.distort_places`.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="scale",
    kind="observation",
    site="camera",
    phases=("image_region",),
    parameters=(Prior("seen", "1", value=1.0, sigma=0.01, relative=False, bounds=(0.8, 1.25)),),
    neutral=(1.0,),
    partners=("lens_distortion", "unequal_radius"),
    phrase="wrong scale of the image",
    reference="A ball radius or a table length that was assumed, not measured",
    rank=20,
)
