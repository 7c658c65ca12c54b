"""Steps that ball models share: slip between the surfaces of two balls, and the effect of an impulse.

Every ball model is a compiled function
`collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)` that returns the first ten of its
arguments after the contact:

    van, vat, vbn, vbt               velocities of balls a and b along n, from the centre of a to that of b, and along
                                     t = z x n, m/s
    wan, wat, waz, wbn, wbt, wbz     spins about the axes n, t, z, rad/s; z points up
    ra, rb                           radii, m
    ma, mb                           masses, kg
    p                                (P,) physical parameters in the order of `parameters.PARAMETER_NAMES`

All arguments are float64, or all are complex128 where a derivative is carried. The balls touch at the height of their
centres. Impulses are in kg m/s.
"""

from __future__ import annotations

from models.numerics.jit import compile_kernel

# Impulse per reduced mass and slip that stops the slip between two solid spheres, which then turn as gears.
STICKING_SHARE = 2.0 / 7.0


@compile_kernel
def surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb):  # type: ignore[no-untyped-def]
    """Return the velocity of the surface of ball a relative to that of ball b along t and z, m/s."""
    return vat - vbt + ra * waz + rb * wbz, -(ra * wat + rb * wbt)


@compile_kernel
def apply_ball_impulse(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, along, up
):
    """Return both balls after impulses of b on a (kg m/s): `normal` against n, `along` along t, `up` along z.

    The balls stay on the table.
    """
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
