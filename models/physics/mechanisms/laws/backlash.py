"""Backlash: play between an actuator and its joint, so that it follows after each reversal with a loss."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="backlash",
    site="actuator",
    strengths=(MechanismStrength("width", lambda scale: scale.unit, lambda scale: scale.position, upper=2.0),),
    partners=("dead_band", "delay"),
    reference="The input moves within the play, of this width, before it pushes on",
)
