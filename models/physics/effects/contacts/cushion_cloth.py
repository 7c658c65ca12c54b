"""Friction of the cloth under a ball that a cushion nose presses down, over that of the free cloth.

It is a multiple of sliding friction, which contact models with a rigid table leave open.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_cloth",
    kind="detail",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("factor", "1", value=1.0, sigma=0.3, relative=True, bounds=(0.2, 5.0)),),
    neutral=(1.0,),
    partners=("cushion_law",),
    phrase="friction of the cloth under the nose",
    reference="Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964), section 4: 0.21 beside a cloth's 0.2",
    rank=12,
    slot=13,
)
