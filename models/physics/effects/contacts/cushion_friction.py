"""Cushion friction: the nose rubs along the ball and turns side spin into motion.

Coulomb friction with one coefficient for all speeds acts during the impact until the surface stops slipping; the
cushion model determines the details.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_friction",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("mu", "1", value=0.17, sigma=0.4, relative=True, bounds=(0.01, 0.6)),),
    neutral=(0.0,),
    partners=("spin_decay", "cushion_law"),
    reference=(
        "Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964): 0.14; Han 2005 (doi:10.1007/BF02919180): 0.2"
    ),
    rank=10,
    slot=8,
)
