"""Ball friction: the surfaces of two balls rub in a contact, which causes throw and transfer of spin.

Coulomb friction with one coefficient for all speeds acts against the slip of the two surfaces until they stick, which
takes an impulse of a seventh of the slip for equal balls.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="ball_friction",
    site="ball",
    phases=("ball_contact",),
    parameters=(Prior("mu", "1", value=0.05, sigma=0.5, relative=True, bounds=(0.001, 0.4)),),
    neutral=(0.0,),
    partners=("ball_law",),
    reference="Alciatore, technical proof A-14: 0.01 to 0.11, falling with the speed of the slip",
    rank=14,
    slot=11,
)
