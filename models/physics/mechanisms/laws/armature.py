"""Armature: inertia of a rotor and its gears, which turn with a joint."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="armature",
    site="joint",
    strengths=(
        MechanismStrength(
            "inertia", lambda scale: "kg m2" if scale.unit == "rad" else "kg",
            lambda scale: scale.force * scale.position / scale.speed**2,
        ),
    ),
    needs_simulator=True,
    partners=("actuator_gain",),
    reference="Inertia of the rotor times the squared gear ratio",
)  # fmt: skip
