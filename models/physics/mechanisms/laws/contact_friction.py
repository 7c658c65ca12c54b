"""Friction of contacts: a factor on the coefficients of all surfaces."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="contact_friction",
    site="mechanism",
    strengths=(
        MechanismStrength("factor", lambda scale: "1", lambda scale: 1.0, lambda scale: 1.0, lower=-0.98, upper=10.0),
    ),
    needs_simulator=True,
    partners=("contact_restitution",),
    reference="Coulomb friction of contacts, over that of the simulator",
)
