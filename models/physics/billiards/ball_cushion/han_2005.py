"""Rigid cushion with Coulomb friction at the height of the nose: Han 2005.

I. Han, "Dynamics in carom and three cushion billiards", Journal of Mechanical Science and Technology 19 (2005) 976-984,
doi:10.1007/BF02919180. The normal impulse is (1 + e) times the closing speed along the contact's normal (eqs 14 to 17);
friction either stops the slip (sliding, then sticking, eq 18) or acts at mu times the normal impulse throughout
(forward sliding, eq 19), whichever is less (eq 20). The vertical velocity after the impact is dropped, as there.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters
from models.physics.billiards.ball_cushion.cushion_contact import approach, push, restitution

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
    closing, st, sk = approach(vn, vt, wn, wt, wz, radius)
    normal = (1.0 + restitution(vn, p)) * closing
    slip = np.sqrt(st * st + sk * sk + 1e-300)
    friction = p[_MU] * normal
    share = friction / slip if friction.real < _STICK * slip.real else 0.0 * slip + _STICK
    return push(vn, vt, wn, wt, wz, radius, normal, -share * st, -share * sk)
