"""Restitution of contacts: a factor on the damping ratio of all of them; less damping, more restitution."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="contact_restitution",
    site="mechanism",
    strengths=(
        MechanismStrength("damping", lambda scale: "1", lambda scale: 1.0, lambda scale: 1.0, lower=-0.98, upper=5.0),
    ),
    needs_simulator=True,
    partners=("contact_friction",),
    reference="Damping ratio of contacts, over that of the simulator",
)
