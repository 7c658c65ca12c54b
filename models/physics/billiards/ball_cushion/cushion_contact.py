"""What every law shares whose cushion touches the ball above its centre: axes of the contact, slip, and push.

The nose of the rail is 1.27 R above the cloth, so the unit normal of the contact N leans up by theta out of the unit
normal n of the cushion: N = cos(theta) n + sin(theta) z, and the contact plane is spanned by t and
k = -sin(theta) n + cos(theta) z. Impulses are per mass of the ball (m/s).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters

NOSE_HEIGHT = 1.27
"""Of the ball's radius, above the cloth: 62.5 to 64.5 % of the diameter (WPA equipment specifications)."""
SINE = NOSE_HEIGHT - 1.0
COSINE = (1.0 - SINE * SINE) ** 0.5

_E = parameters.CUSHION_E
_SLOPE, _POWER = parameters.CUSHION_E_SLOPE, parameters.CUSHION_E_POWER


@compiled
def restitution(vn, p):  # type: ignore[no-untyped-def]
    """Restitution e0 vn^-power - slope vn at the normal speed `vn` (m/s), held between 0 and 1."""
    e = p[_E] * np.exp(-p[_POWER] * np.log(vn)) - p[_SLOPE] * vn
    if e.real > 1.0:
        return 0.0 * e + 1.0
    if e.real < 0.0:
        return 0.0 * e
    return e


@compiled
def approach(vn, vt, wn, wt, wz, radius):  # type: ignore[no-untyped-def]
    """Closing speed along N, and slip of the ball's surface along t and k (m/s)."""
    return COSINE * vn, vt + radius * (COSINE * wz - SINE * wn), -SINE * vn - radius * wt


@compiled
def push(vn, vt, wn, wt, wz, radius, normal, along, up):  # type: ignore[no-untyped-def]
    """Velocity and spin after the cushion pushed by `normal` against N, `along` along t and `up` along k.

    The vertical velocity is dropped. A weak push on a ball with heavy spin can leave it moving into the cushion; the
    cloth holds it there, which takes that motion away.
    """
    spin = 2.5 / radius
    vn = vn - COSINE * normal - SINE * up
    if vn.real > 0.0:
        vn = 0.0 * vn
    return vn, vt + along, wn - SINE * spin * along, wt - spin * up, wz + COSINE * spin * along
