"""Spin decay: friction of the cloth stops the rotation of a ball about the vertical.

|wz| falls at one constant rate in every phase of the motion. The effect is visible only after the next contact.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="spin_decay",
    site="cloth",
    phases=("cushion_contact", "ball_contact"),
    parameters=(Prior("rate", "rad/s2", value=10.0, sigma=0.5, relative=True, bounds=(0.1, 60.0)),),
    neutral=(0.0,),
    partners=("cushion_friction",),
    phrase="decay of side spin",
    reference="Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 5 to 15 rad/s2",
    rank=2,
    slot=2,
)
