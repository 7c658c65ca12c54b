"""Ball against ball with a constant restitution (Newton) and a constant coefficient of friction (Coulomb).

Friction acts at mu times the normal impulse against the slip of the two surfaces, in the plane of the table and up or
down, but never reverses it (Walton 1993, in Particulate Two-Phase Flow, ch. 25).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters
from models.physics.billiards.ball_ball.ball_contact import STICK, exchange, slip_between

USES = ("ball_restitution.e", "ball_friction.mu")

_E = parameters.BALL_E
_MU = parameters.BALL_MU


@compiled
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Velocities (m/s) and spins (rad/s) of balls a and b after the contact, in the axes n, t, z."""
    reduced = ma * mb / (ma + mb)
    normal = (1.0 + p[_E]) * (van - vbn) * reduced
    st, sz = slip_between(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    bound, stick = p[_MU] * normal, STICK * reduced
    share = bound / slip if bound.real < stick.real * slip.real else stick
    return exchange(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, -share * st, -share * sz)
