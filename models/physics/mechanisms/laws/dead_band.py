"""Dead band: an actuator does nothing for a small input; a servo, for a small error of its position."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="dead_band",
    site="actuator",
    strengths=(MechanismStrength("width", lambda scale: scale.unit, lambda scale: scale.position, upper=2.0),),
    partners=("backlash", "joint_friction"),
    needs_small_inputs=True,
    reference="u = asked - width sign(asked) outside, 0 inside",
)
