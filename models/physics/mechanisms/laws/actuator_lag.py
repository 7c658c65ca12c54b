"""Actuator lag: an input acts through a first-order low pass."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

# s, a usual time constant over `USUAL_SHARE`.
_USUAL = 0.2

EFFECT = MechanismEffect(
    name="actuator_lag",
    site="actuator",
    strengths=(MechanismStrength("time", lambda scale: "s", lambda scale: _USUAL, upper=5.0),),
    partners=("delay",),
    reference="T u' = asked - u",
)
