"""What every law of two balls shares: slip between their surfaces, and the exchange of an impulse.

The balls touch at the height of their centres, normal n from ball a to ball b; impulses in kg m/s.
"""

from __future__ import annotations

from models.numerics.jit import compiled

STICK = 2.0 / 7.0
"""Impulse per reduced mass and slip that stops the slip between two solid spheres: they then turn as gears."""


@compiled
def slip_between(vat, wat, waz, vbt, wbt, wbz, ra, rb):  # type: ignore[no-untyped-def]
    """Velocity of a's surface over b's along t and z (m/s)."""
    return vat - vbt + ra * waz + rb * wbz, -(ra * wat + rb * wbt)


@compiled
def exchange(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, along, up
):
    """Both balls after b pushed a by `normal` against n, `along` along t, `up` along z; they stay on the table."""
    spin_a, spin_b = 2.5 / (ma * ra), 2.5 / (mb * rb)
    return (
        van - normal / ma,
        vat + along / ma,
        wan,
        wat - spin_a * up,
        waz + spin_a * along,
        vbn + normal / mb,
        vbt - along / mb,
        wbn,
        wbt - spin_b * up,
        wbz + spin_b * along,
    )
