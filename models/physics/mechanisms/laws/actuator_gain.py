"""Actuator gain: an actuator does more, or less, than the simulator assumes."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="actuator_gain",
    site="actuator",
    strengths=(
        MechanismStrength("gain", lambda scale: "1", lambda scale: 1.0, lambda scale: 1.0, lower=-1.0, upper=5.0),
    ),
    partners=("saturation", "armature"),
    reference="Force of the actuator over that of the simulator",
)
