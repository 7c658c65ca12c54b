"""Joint friction: a dry part, which does not depend on speed, and a viscous one: F = -dry sign(v) - viscous v."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, in_force, per

EFFECT = MechanismEffect(
    name="joint_friction",
    site="joint",
    strengths=(
        MechanismStrength("dry", in_force, lambda scale: scale.force),
        MechanismStrength("viscous", *per(1, "speed")),
    ),
    dry=lambda q, v, p: p[0],
    brake=lambda q, v, p: p[1],
    partners=("stribeck", "air_drag"),
    reference="Coulomb and viscous friction; Olsson et al. 1998, doi:10.1016/S0947-3580(98)70113-X",
)
