"""Cushion restitution that falls in proportion to speed: e = e0 - slope v.

v is the speed normal to the cushion at impact, m/s.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_restitution_speed",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("slope", "s/m", value=0.0, sigma=0.05, relative=False, bounds=(-0.2, 0.2)),),
    neutral=(0.0,),
    partners=("air_drag", "cushion_restitution"),
    phrase="cushion restitution that falls with speed",
    limits=(-math.inf, math.inf),
    reference=(
        "Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964): restitution falls with the speed of the impact"
    ),
    rank=8,
    slot=7,
)
