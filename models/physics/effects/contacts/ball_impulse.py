"""Generic law of two balls: a smooth change of the impulse that any contact model gives.

The restitution changes by e_0 + e_1 v with the closing speed v (m/s), and the slip u of the surfaces is met by an
impulse per reduced mass of -(grip_0 + grip_1 v / sqrt(v^2 + u^2)) u.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="ball_impulse",
    kind="probe",
    site="ball",
    phases=("ball_contact",),
    parameters=(
        Prior("e_0", "1", value=0.0, sigma=0.05, relative=False, bounds=(-0.3, 0.3)),
        Prior("e_1", "s/m", value=0.0, sigma=0.03, relative=False, bounds=(-0.2, 0.2)),
        Prior("grip_0", "1", value=0.0, sigma=0.05, relative=False, bounds=(-0.3, 0.3)),
        Prior("grip_1", "1", value=0.0, sigma=0.05, relative=False, bounds=(-0.3, 0.3)),
    ),
    neutral=(0.0,) * 4,
    limits=(-math.inf, math.inf),
    reference="Low powers of speed and slip",
    rank=25,
    slot=17,
)
