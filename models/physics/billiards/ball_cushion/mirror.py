"""Cushion as a wall that touches the ball at the height of its centre: restitution, and Coulomb friction with spin.

The normal velocity comes back times e. Friction acts along the cushion against the slip there, at mu times the normal
impulse, at most what stops the slip: 2/7 of it for a solid sphere. The part of the slip that is up or down is left
alone, for a ball that rolls straight at a real cushion keeps its roll (its nose is above the centre); so a head-on ball
without side spin is returned with its spin unchanged.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters
from models.physics.billiards.ball_cushion.cushion_contact import restitution

USES = (
    "cushion_restitution.e", "cushion_restitution_speed.slope", "cushion_restitution_power.power",
    "cushion_friction.mu",
)  # fmt: skip

_MU = parameters.CUSHION_MU
_STICK = 2.0 / 7.0
"""Impulse per mass and slip that stops the slip of a solid sphere."""


@compiled
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Velocity (m/s) and spin (rad/s) after the cushion, in the axes n, t, z."""
    e = restitution(vn, p)
    slip = vt + radius * wz
    size = np.sqrt(slip * slip + 1e-300)
    bound = p[_MU] * (1.0 + e) * vn
    share = bound / size if bound.real < _STICK * size.real else 0.0 * size + _STICK
    along = -share * slip
    return -e * vn, vt + along, wn + 0.0 * e, wt + 0.0 * e, wz + 2.5 / radius * along
