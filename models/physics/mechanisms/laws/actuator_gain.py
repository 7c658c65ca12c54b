"""Actuator gain: an actuator does more, or less, than the simulator assumes.

A servo also has a gain of its speed, and either may have another largest force. A motor loses force as it turns faster,
in proportion to its speed, by the voltage that it generates itself: with power alone, and beyond any largest force.
"""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

# A usual change over `USUAL_SHARE`: gains of hobby servos are guesses.
_USUAL = 3.0


EFFECT = MechanismEffect(
    name="actuator_gain",
    site="actuator",
    strengths=(
        *(
            MechanismStrength(
                name, lambda scale: "1", lambda scale: _USUAL, lambda scale: 1.0, -1 / _USUAL, 7.0, name != "gain"
            )
            for name in ("gain", "damping", "limit")
        ),
        # a joint hardly moves faster than its motor without a load
        MechanismStrength(
            "fall", lambda scale: f"s/{scale.joint_unit}", lambda scale: 1 / scale.speed, upper=3.0,
            needs_simulator=True,
        ),
    ),
    partners=("saturation", "armature"),
    reference="Force over that of the simulator, of a servo's damping, and of its largest force, which speed reduces",
)  # fmt: skip
