"""Actuator gain: an actuator does more, or less, than the simulator assumes.

A servo also has a gain of its speed, and either may have another largest force.
"""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

# A usual change over `USUAL_SHARE`: gains of hobby servos are guesses.
_USUAL = 3.0


EFFECT = MechanismEffect(
    name="actuator_gain",
    site="actuator",
    strengths=tuple(
        MechanismStrength(
            name, lambda scale: "1", lambda scale: _USUAL, lambda scale: 1.0, -1 / _USUAL, 7.0, name != "gain"
        )
        for name in ("gain", "damping", "limit")
    ),
    partners=("saturation", "armature"),
    reference="Force of the actuator over that of the simulator, of a servo's damping, and of its largest force",
)
