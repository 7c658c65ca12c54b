"""Unequal radius: the first ball of a shot is smaller or larger than all others.

ratio = radius of every other ball over the radius of the first one. It shifts times and places of contacts. The centres
of all balls are assumed to lie in one plane.
"""

from __future__ import annotations

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="unequal_radius",
    site="set",
    phases=("ball_contact", "cushion_contact"),
    parameters=(Prior("ratio", "1", value=1.0, sigma=0.02, relative=False, bounds=(0.8, 1.25)),),
    neutral=(1.0,),
    partners=("scale", "lens_distortion"),
    phrase="unequal sizes of balls",
    reference="Coin-operated tables: cue balls of 2 3/8 in among balls of 2 1/4 in; worn ones are smaller",
    rank=16,
)
