"""Stribeck friction: dry friction that is larger at low speed: F = -rise exp(-(v / speed)^2) sign(v)."""

from __future__ import annotations

import numpy as np

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, in_force

# Share of the typical speed at which the rise has fallen to 1/e.
_USUAL_SPEED = 0.1

EFFECT = MechanismEffect(
    name="stribeck",
    site="joint",
    strengths=(
        MechanismStrength("rise", in_force, lambda scale: scale.force),
        MechanismStrength(
            "speed", lambda scale: f"{scale.unit}/s", lambda scale: scale.speed,
            neutral=lambda scale: _USUAL_SPEED * scale.speed, lower=-0.9 * _USUAL_SPEED, upper=1.0,
        ),
    ),
    dry=lambda q, v, p: p[0] * np.exp(-np.square(v / p[1])),
    partners=("joint_friction",),
    reference="Stribeck 1902; Olsson et al. 1998, doi:10.1016/S0947-3580(98)70113-X, eq. 4",
)  # fmt: skip
