"""Cushion restitution that falls with a power of the speed: e = e0 v^-power - slope v, v in m/s.

This is the part that a straight line leaves open: much restitution is lost at low speeds already.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_restitution_power",
    kind="detail",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("power", "1", value=0.0, sigma=0.1, relative=False, bounds=(-0.2, 0.6)),),
    neutral=(0.0,),
    partners=("cushion_restitution_speed",),
    phrase="power of that fall",
    limits=(-math.inf, math.inf),
    reference="Johnson 1985, Contact Mechanics, section 11.5: e falls with the fourth root of the speed",
    rank=9,
    slot=14,
)
