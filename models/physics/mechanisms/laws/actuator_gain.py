"""Actuator gain: an actuator does more, or less, than the simulator assumes; a servo also has a gain of its speed."""

from __future__ import annotations

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength, Scale

# A usual change over `USUAL_SHARE`: gains of hobby servos are guesses.
_USUAL = 3.0


def _one(scale: Scale) -> str:
    return "1"


def _usual(scale: Scale) -> float:
    return _USUAL


def _neutral(scale: Scale) -> float:
    return 1.0


EFFECT = MechanismEffect(
    name="actuator_gain",
    site="actuator",
    strengths=(
        MechanismStrength("gain", _one, _usual, neutral=_neutral, lower=-1 / _USUAL, upper=7.0),
        MechanismStrength(
            "damping", _one, _usual, neutral=_neutral, lower=-1 / _USUAL, upper=7.0, needs_simulator=True
        ),
    ),
    partners=("saturation", "armature"),
    reference="Force of the actuator over that of the simulator, and of a servo's damping over that of the simulator",
)
