"""Cushion restitution: normal speed after a cushion over that before it, for slow balls.

`cushion_restitution_speed` and `cushion_restitution_power` describe its dependence on speed.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_restitution",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("e", "1", value=0.75, sigma=0.2, relative=False, bounds=(0.2, 1.0)),),
    neutral=(1.0,),
    partners=("cushion_restitution_speed",),
    limits=(0.0, 1.0),
    reference="Mathavan, Jackson, Parkin 2010, doi:10.1243/09544062JMES1964: 0.75 to 0.98 by law and speed",
    rank=7,
    slot=6,
)
