"""Rolling resistance of the cloth: the centre of a rolling ball decelerates at mu g."""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="rolling_resistance",
    site="cloth",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(Prior("mu", "1", value=0.01, sigma=0.4, relative=True, bounds=(0.001, 0.05)),),
    neutral=(0.0,),
    partners=("slope", "nap", "viscous_drag"),
    reference="Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.005 to 0.015",
    rank=0,
    slot=1,
)
