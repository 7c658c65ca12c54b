"""Saturation: an actuator gives no more than a limit."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="saturation",
    site="actuator",
    strengths=(
        MechanismStrength(
            "limit", lambda scale: scale.unit, lambda scale: scale.largest, lambda scale: scale.largest, -0.98, 0.0
        ),
    ),
    partners=("actuator_gain",),
    reference="Largest input that has a further effect; absent at the largest one of the recordings",
)
