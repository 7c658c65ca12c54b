"""Ball restitution: separation speed of two balls over their closing speed, the same at all speeds."""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="ball_restitution",
    site="ball",
    phases=("ball_contact",),
    parameters=(Prior("e", "1", value=0.94, sigma=0.05, relative=False, bounds=(0.7, 1.0)),),
    neutral=(1.0,),
    partners=("unequal_mass",),
    limits=(0.0, 1.0),
    reference="Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.92 to 0.98",
    rank=13,
    slot=10,
)
