"""Ball against ball without loss and without friction: the velocities along the line of centres are exchanged."""

from __future__ import annotations

from models.numerics.jit import compiled
from models.physics.billiards.ball_ball.ball_contact import exchange

USES = ()


@compiled
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Velocities (m/s) and spins (rad/s) of balls a and b after the contact, in the axes n, t, z."""
    normal = 2.0 * (van - vbn) * ma * mb / (ma + mb)
    none = 0.0 * p[0]
    return exchange(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, none, none)
