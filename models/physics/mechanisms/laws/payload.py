"""A payload: mass at the centre of the last body of the mechanism that the simulator does not have."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="payload",
    site="mechanism",
    strengths=(MechanismStrength("mass", lambda scale: "kg", lambda scale: scale.inertia, lower=-0.9, upper=10.0),),
    needs_simulator=True,
    partners=("gravity", "armature"),
    reference="Mass added to the last body, with the inertia of its own in proportion",
)
