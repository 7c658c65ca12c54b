"""Scale of a sensor: measured over true positions."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="sensor_scale",
    site="sensor_body",
    strengths=(
        MechanismStrength("factor", lambda scale: "1", lambda scale: 1.0, lambda scale: 1.0, lower=-0.9, upper=5.0),
    ),
    kind="observation",
    reference="measured = factor x true + offset",
)
