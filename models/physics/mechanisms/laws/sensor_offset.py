"""Offset of a sensor: what it measures where the simulator has 0."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="sensor_offset",
    site="sensor",
    strengths=(
        MechanismStrength("offset", lambda scale: scale.unit, lambda scale: scale.position, lower=-10.0, upper=10.0),
    ),
    partners=("spring", "gravity"),
    kind="observation",
    reference="measured = factor x true + offset",
)
