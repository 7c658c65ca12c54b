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

The nose touches the ball h R above the cloth, where h is `cushion_height.ratio` or, where that is 0, the height of the
model: 1.27 in the published ones. So the unit normal of the contact N leans up by theta out of n, sin(theta) = h - 1:
N = cos(theta) n + sin(theta) z, and the contact plane is spanned by t and k = -sin(theta) n + cos(theta) z. Impulses
are per mass of the ball, m/s.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector

# Height of the nose above the cloth over the ball's radius: 62.5 to 64.5 % of the diameter (WPA equipment
# specifications).
NOSE_HEIGHT = 1.27
NOSE_HEIGHT_PARAMETER = "cushion_height.ratio"
# Least height of a contact over the radius, see `models.physics.effects.contacts.cushion_height`.
LEAST_HEIGHT = 0.5

# Parameters that every cushion model reads.
CUSHION_PARAMETERS = (
    "cushion_restitution.e",
    "cushion_restitution_speed.slope",
    "cushion_restitution_power.power",
    "cushion_friction.mu",
    NOSE_HEIGHT_PARAMETER,
)

_E = parameter_vector.CUSHION_E
_SLOPE, _POWER = parameter_vector.CUSHION_E_SLOPE, parameter_vector.CUSHION_E_POWER
_HEIGHT = parameter_vector.CUSHION_HEIGHT


@compile_kernel
def contact_inclination(p, standard_height):  # type: ignore[no-untyped-def]
    """Evaluate the sine and cosine of the angle theta by which the normal of the contact leans up.

    Args:
        p: (P,) physical parameters.
        standard_height: Height of the contact over the radius where `cushion_height.ratio` is 0. Values near 0, below
            any real height, are added to it, so that there is a derivative at 0.

    Returns:
        sin(theta) and cos(theta).
    """
    height = p[_HEIGHT]
    if height.real < LEAST_HEIGHT:
        height = height + standard_height
    sine = height - 1.0
    return sine, np.sqrt(1.0 - sine * sine)


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
def contact_velocities(vn, vt, wn, wt, wz, radius, sine, cosine):  # type: ignore[no-untyped-def]
    """Return the closing speed along N, and the slip of the ball's surface along t and k, m/s."""
    return cosine * vn, vt + radius * (cosine * wz - sine * wn), -sine * vn - radius * wt


@compile_kernel
def apply_cushion_impulse(vn, vt, wn, wt, wz, radius, normal, along, up, sine, cosine):  # type: ignore[no-untyped-def]
    """Return velocity and spin after impulses per mass (m/s): `normal` against N, `along` along t, `up` along k.

    The vertical velocity is dropped. A weak push on a ball with heavy spin can leave it moving into the cushion; the
    cloth stops that motion.
    """
    spin = 2.5 / radius
    vn = vn - cosine * normal - sine * up
    if vn.real > 0.0:
        vn = 0.0 * vn
    return vn, vt + along, wn - sine * spin * along, wt - spin * up, wz + cosine * spin * along
