"""Layout of the vector of physical parameters, and the values of effects that are absent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NAMES: tuple[str, ...] = (
    "sliding_friction.mu",
    "rolling_resistance.mu",
    "spin_decay.rate",
    "slope.slope_x",
    "slope.slope_y",
    "air_drag.k",
    "viscous_drag.k",
    "cushion_restitution.e",
    "cushion_restitution_speed.slope",
    "cushion_friction.mu",
    "ball_restitution.e",
    "ball_friction.mu",
)
"""Effect and parameter, in the order of the vector, in the units of the effect."""

SLIDING_MU, ROLLING_MU, SPIN_DECAY, SLOPE_X, SLOPE_Y, AIR_DRAG, VISCOUS_DRAG = range(7)
CUSHION_E, CUSHION_E_SLOPE, CUSHION_MU, BALL_E, BALL_MU = range(7, 12)


def neutral() -> NDArray[np.float64]:
    """The vector (P,) of a world without effects: no friction, elastic, flat."""
    values = np.zeros(len(NAMES))
    values[[CUSHION_E, BALL_E]] = 1.0
    return values
