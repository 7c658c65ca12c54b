"""Unequal mass: the first ball of a shot is lighter or heavier than all others.

ratio = mass of every other ball over the mass of the first one. Only contacts of balls show it.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="unequal_mass",
    site="set",
    phases=("ball_contact",),
    parameters=(Prior("ratio", "1", value=1.0, sigma=0.05, relative=False, bounds=(0.5, 2.0)),),
    neutral=(1.0,),
    partners=("ball_restitution",),
    phrase="unequal masses of balls",
    reference="Coin-operated tables: cue balls up to 10 % heavier; worn ones some per cent lighter",
    rank=15,
)
