"""Generic law of cushions: a smooth change of the rebound that any contact model gives.

The restitution changes by e_0 + e_1 vn + e_2 sin^2(a), with the normal speed vn (m/s) and the angle a to the normal.
The slip u of the surface along the cushion is met by an impulse per mass of -(grip_0 + grip_1 vn / sqrt(vn^2 + u^2)) u
at the height of the centre, and the share `roll` of the spin about the direction along the cushion is lost.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cushion_rebound",
    kind="probe",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(
        Prior("e_0", "1", value=0.0, sigma=0.05, relative=False, bounds=(-0.5, 0.5)),
        Prior("e_1", "s/m", value=0.0, sigma=0.05, relative=False, bounds=(-0.3, 0.3)),
        Prior("e_2", "1", value=0.0, sigma=0.1, relative=False, bounds=(-0.5, 0.5)),
        Prior("grip_0", "1", value=0.0, sigma=0.15, relative=False, bounds=(-0.5, 0.5)),
        Prior("grip_1", "1", value=0.0, sigma=0.15, relative=False, bounds=(-0.5, 0.5)),
        Prior("roll", "1", value=0.0, sigma=0.15, relative=False, bounds=(-0.5, 1.0)),
    ),
    neutral=(0.0,) * 6,
    limits=(-math.inf, math.inf),
    reference="Low powers of speed, angle and slip that are symmetric under reflection",
    rank=24,
    slot=16,
)
