"""Air drag decelerates a joint with the square of its speed: F = -k v |v|."""

from __future__ import annotations

import numpy as np

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, per

EFFECT = MechanismEffect(
    name="air_drag",
    site="joint",
    strengths=(MechanismStrength("k", *per(2, "speed")),),
    brake=lambda q, v, p: p[0] * np.abs(v),
    partners=("joint_friction",),
    reference="Turbulent drag of a body that moves with the joint",
)
