"""Ball against ball with a friction that falls with the speed of the slip: Alciatore's technical proof A-14.

D. G. Alciatore, "The effects of cut angle, speed, and spin on object ball throw", technical proof A-14 (2006,
billiards.colostate.edu/technical_proofs): mu = 0.00995 + 0.108 exp(-1.088 v), v in m/s the relative speed of the two
surfaces when they meet, fitted to the measurements of Marlow (The Physics of Pocket Billiards, 1995). Friction acts at
mu times the normal impulse against the slip, in the plane of the table and up or down, but never reverses it: less
than that bound is needed once the surfaces run as gears (technical proof A-6: 1/7 of the slip for equal balls).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters
from models.physics.billiards.ball_ball.ball_contact import STICK, exchange, slip_between

USES = ("ball_restitution.e",)

FLOOR = 0.00995
RISE = 0.108
FALL = 1.088
"""s/m."""

_E = parameters.BALL_E


@compiled
def friction(slip):  # type: ignore[no-untyped-def]
    """Coefficient at the relative speed `slip` (m/s) of the two surfaces."""
    return FLOOR + RISE * np.exp(-FALL * slip)


@compiled
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Velocities (m/s) and spins (rad/s) of balls a and b after the contact, in the axes n, t, z."""
    reduced = ma * mb / (ma + mb)
    normal = (1.0 + p[_E]) * (van - vbn) * reduced
    st, sz = slip_between(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    bound, stick = friction(slip) * normal, STICK * reduced
    share = bound / slip if bound.real < stick.real * slip.real else stick
    return exchange(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, -share * st, -share * sz)
