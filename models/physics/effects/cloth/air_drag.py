"""Air drag decelerates a ball with the square of its speed: a = -k v v."""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="air_drag",
    site="cloth",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(Prior("k", "1/m", value=0.0, sigma=0.03, relative=False, bounds=(0.0, 1.0)),),
    neutral=(0.0,),
    partners=("viscous_drag", "cushion_restitution_speed"),
    bends_path=True,
    reference="A sphere in air: k = 3 c rho / (8 R density), 0.004 1/m for a pool ball with c = 0.45",
    rank=4,
    slot=4,
)
