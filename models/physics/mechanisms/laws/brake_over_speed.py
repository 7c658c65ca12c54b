"""A probe for an unnamed brake of every joint: a cubic in speed, against the motion."""

from __future__ import annotations

import numpy as np

from models.physics.mechanisms.mechanism_effect import MechanismEffect, MechanismStrength

# All joints share the coefficients, in multiples of the force and speed that are typical of each.
_POWERS = range(4)

EFFECT = MechanismEffect(
    name="brake_over_speed",
    site="mechanism",
    strengths=tuple(MechanismStrength(f"c{n}", lambda scale: "1", lambda scale: 1.0, lower=-30.0) for n in _POWERS),
    dry=lambda q, v, p: p[0],
    brake=lambda q, v, p: p[1] + p[2] * np.abs(v) + p[3] * np.square(v),
    reference="a cubic in speed",
    kind="probe",
)
