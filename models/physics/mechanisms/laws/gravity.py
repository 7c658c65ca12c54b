"""Gravity of another size or direction than the simulator has, or a mechanism that is mounted at a slant."""

from __future__ import annotations

from models.core.constants import GRAVITY
from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

EFFECT = MechanismEffect(
    name="gravity",
    site="mechanism",
    strengths=tuple(
        MechanismStrength(axis, lambda scale: "m/s2", lambda scale: GRAVITY, lower=-2.0, upper=2.0) for axis in "xyz"
    ),
    needs_simulator=True,
    partners=("spring", "payload"),
    reference="Change of the acceleration of gravity, in the axes of the simulator",
)
