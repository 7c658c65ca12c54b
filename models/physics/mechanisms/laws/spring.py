"""A spring pulls a joint towards a place: F = rest_force - stiffness q; its rest is at rest_force / stiffness."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, in_force, per

EFFECT = MechanismEffect(
    name="spring",
    site="line",
    strengths=(
        MechanismStrength("stiffness", *per(1, "position"), lower=-1.0),
        MechanismStrength("rest_force", in_force, lambda scale: scale.force, lower=-30.0),
    ),
    force=lambda q, v, p: p[1] - p[0] * q,
    partners=("sensor_offset", "gravity"),
    reference="Hooke's law, about a rest of its own",
)
