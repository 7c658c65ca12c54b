"""Cushion height: how far above the cloth the nose of a cushion touches a ball, over the ball's radius.

A nose above the centre presses the ball down and rubs against its roll. Every cushion model has a height of its own,
which it keeps where no other is given: the neutral value 0 stands for that height (`ContactModel.standard_values`), and
values below the least limit are a distance from it.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_height",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("ratio", "1", value=1.27, sigma=0.1, relative=False, bounds=(1.0, 1.5)),),
    neutral=(0.0,),
    partners=("cushion_restitution", "cushion_friction", "cushion_law"),
    phrase="height of the cushion nose",
    limits=(0.5, 1.5),
    reference=(
        "WPA equipment specifications: 62.5 to 64.5 % of the diameter, 1.25 to 1.29; carom, 37 mm at balls of 61.5 mm:"
        " 1.20; Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964): 1.4"
    ),
    rank=11,
    slot=9,
)
