"""Delay: an input acts later than it was recorded, by the time of bus, driver and clock."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

# s, a usual delay over `USUAL_SHARE`.
_USUAL = 0.2

EFFECT = MechanismEffect(
    name="delay",
    site="actuator",
    strengths=(MechanismStrength("time", lambda scale: "s", lambda scale: _USUAL, upper=2.5),),
    partners=("actuator_lag", "backlash"),
    reference="u(t) = asked(t - time)",
)
