"""Slope: a table that is not level accelerates every ball downhill.

The acceleration is g s for a sliding ball and 5/7 g s for a rolling one; a ball at rest stays while rolling resistance
exceeds it. s is constant over the table and positive where the surface falls towards +x, +y.
"""

from __future__ import annotations

import math

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="slope",
    site="cloth",
    phases=("free_roll", "after_strike", "ball_contact", "cushion_contact"),
    parameters=(
        Prior("slope_x", "mm/m", value=0.0, sigma=2.0, relative=False, bounds=(-20.0, 20.0)),
        Prior("slope_y", "mm/m", value=0.0, sigma=2.0, relative=False, bounds=(-20.0, 20.0)),
    ),
    neutral=(0.0, 0.0),
    partners=("rolling_resistance", "nap", "perspective"),
    limits=(-math.inf, math.inf),
    bends_path=True,
    reference=(
        "WPA equipment specifications, section 3: level within 0.02 in over the length, about 0.2 mm/m; homes are worse"
    ),
    rank=3,
    slot=3,
)
