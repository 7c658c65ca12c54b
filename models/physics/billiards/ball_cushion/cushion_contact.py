"""Steps that cushion models share: axes of the contact, restitution, slip and impulse.

Every cushion model is a compiled function `rebound(vn, vt, wn, wt, wz, radius, mass, p)` that returns
(vn, vt, wn, wt, wz) after the contact:

    vn, vt       velocity of the centre along n, the unit normal into the cushion, and along t = z x n, m/s; vn > 0
                 before the contact
    wn, wt, wz   spin about the axes n, t, z, rad/s; z points up
    radius       of the ball, m
    mass         of the ball, kg
    p            (P,) physical parameters in the order of `parameters.PARAMETER_NAMES`

All arguments are float64, or all are complex128 where a derivative is carried.

In the published models the nose of the cushion is 1.27 R above the cloth, so the unit normal of the contact N leans up
by theta out of n: N = cos(theta) n + sin(theta) z, and the contact plane is spanned by t and
k = -sin(theta) n + cos(theta) z. Impulses are per mass of the ball, m/s.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector

NOSE_HEIGHT = 1.27
"""Height of the nose above the cloth over the ball's radius: 62.5 to 64.5 % of the diameter (WPA equipment
specifications)."""
SIN_THETA = NOSE_HEIGHT - 1.0
COS_THETA = (1.0 - SIN_THETA * SIN_THETA) ** 0.5

CUSHION_PARAMETERS = (
    "cushion_restitution.e",
    "cushion_restitution_speed.slope",
    "cushion_restitution_power.power",
    "cushion_friction.mu",
)
"""Parameters that every cushion model reads."""

_E = parameter_vector.CUSHION_E
_SLOPE, _POWER = parameter_vector.CUSHION_E_SLOPE, parameter_vector.CUSHION_E_POWER


@compile_kernel
def restitution_at_speed(vn, p):  # type: ignore[no-untyped-def]
    """Evaluate the restitution e0 vn^-power - slope vn, clipped to 0 to 1.

    Args:
        vn: Normal speed before the contact, m/s.
        p: (P,) physical parameters.

    Returns:
        The restitution.
    """
    e = p[_E] * np.exp(-p[_POWER] * np.log(vn)) - p[_SLOPE] * vn
    if e.real > 1.0:
        return 0.0 * e + 1.0
    if e.real < 0.0:
        return 0.0 * e
    return e


@compile_kernel
def contact_velocities(vn, vt, wn, wt, wz, radius):  # type: ignore[no-untyped-def]
    """Return the closing speed along N, and the slip of the ball's surface along t and k, m/s."""
    return COS_THETA * vn, vt + radius * (COS_THETA * wz - SIN_THETA * wn), -SIN_THETA * vn - radius * wt


@compile_kernel
def apply_cushion_impulse(vn, vt, wn, wt, wz, radius, normal, along, up):  # type: ignore[no-untyped-def]
    """Return velocity and spin after impulses per mass (m/s): `normal` against N, `along` along t, `up` along k.

    The vertical velocity is dropped. A weak push on a ball with heavy spin can leave it moving into the cushion; the
    cloth stops that motion.
    """
    spin = 2.5 / radius
    vn = vn - COS_THETA * normal - SIN_THETA * up
    if vn.real > 0.0:
        vn = 0.0 * vn
    return vn, vt + along, wn - SIN_THETA * spin * along, wt - spin * up, wz + COS_THETA * spin * along
