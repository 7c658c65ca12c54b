"""Nap: the fibres of a snooker cloth lie in one direction, here towards +x.

A ball that rolls at an angle a to +x decelerates at (mu_r - mu cos a) g: less with the nap than against it. mu is
negative where the nap lies towards -x. |mu| stays below rolling resistance, because a cloth cannot drive a ball.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="nap",
    site="cloth",
    phases=("free_roll",),
    parameters=(Prior("mu", "1", value=0.0, sigma=0.002, relative=False, bounds=(-0.02, 0.02)),),
    neutral=(0.0,),
    partners=("slope", "rolling_shutter"),
    phrase="nap of the cloth",
    limits=(-math.inf, math.inf),
    reference="Cloths with a nap (snooker, English billiards): balls run further with it than against it",
    rank=6,
    slot=12,
)
