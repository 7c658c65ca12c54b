"""Generic law of the cloth: a force on a moving ball that is a smooth function of its velocity.

A ball with speed v that moves along h, with l to its left, is accelerated by
-(brake_1 v + brake_2 v^2 + brake_3 v^3) h + (turn_0 v / sqrt(v^2 + v0^2) + turn_1 v) l, with v0 = 0.02 m/s, and pulled
as if the table sloped by pull_x, pull_y. A negative brake offsets at most drag and rolling resistance, and so drives
no ball.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="cloth_force",
    kind="probe",
    site="cloth",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(
        Prior("brake_1", "1/s", value=0.0, sigma=0.05, relative=False, bounds=(-2.0, 2.0)),
        Prior("brake_2", "1/m", value=0.0, sigma=0.03, relative=False, bounds=(-1.0, 1.0)),
        Prior("brake_3", "s/m2", value=0.0, sigma=0.02, relative=False, bounds=(-1.0, 1.0)),
        Prior("turn_0", "m/s2", value=0.0, sigma=0.02, relative=False, bounds=(-1.0, 1.0)),
        Prior("turn_1", "1/s", value=0.0, sigma=0.05, relative=False, bounds=(-2.0, 2.0)),
        Prior("pull_x", "mm/m", value=0.0, sigma=2.0, relative=False, bounds=(-20.0, 20.0)),
        Prior("pull_y", "mm/m", value=0.0, sigma=2.0, relative=False, bounds=(-20.0, 20.0)),
    ),
    neutral=(0.0,) * 7,
    limits=(-math.inf, math.inf),
    bends_path=True,
    reference="Powers of the speed along the motion, across it, and a constant",
    rank=23,
    slot=15,
)
