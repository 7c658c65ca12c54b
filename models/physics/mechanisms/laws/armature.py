"""Armature: inertia of a rotor and its gears, which turn with a joint."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="armature",
    site="joint",
    strengths=(
        MechanismStrength(
            "inertia", lambda scale: "1" if not scale.has_forces else "kg m2" if scale.unit == "rad" else "kg",
            lambda scale: scale.force * scale.position / scale.speed**2,
        ),
    ),
    partners=("actuator_gain",),
    reference="Inertia of the rotor times the squared gear ratio; over that of the joint where forces are unknown",
)  # fmt: skip
