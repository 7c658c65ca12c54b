"""Contacts of balls on the table: from the frame of the table into that of a law, through the law, and back.

Velocity and spin are turned about the vertical, which turns both as vectors. Gentle contacts (see roots.py) are
returned without loss and friction whatever the law, and the micrometre that the balls had sunk in is taken back: so the
next such contact takes its time, and balls that press on each other do not creep into each other.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.numerics.roots import DEPTH
from models.physics.billiards.ball_ball import alciatore, elastic, inelastic, mass_spring
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge


@compiled
def rebound(law, vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """`law` is an index in `parameters.CUSHION_LAWS`."""
    if law == 0:
        return mirror.rebound(vn, vt, wn, wt, wz, radius, mass, p)
    if law == 1:
        return han_2005.rebound(vn, vt, wn, wt, wz, radius, mass, p)
    if law == 2:
        return mathavan_2010.rebound(vn, vt, wn, wt, wz, radius, mass, p)
    return stronge.rebound(vn, vt, wn, wt, wz, radius, mass, p)


@compiled
def collide(law, van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p):  # type: ignore[no-untyped-def]
    """`law` is an index in `parameters.BALL_LAWS`."""
    if law == 1:
        return inelastic.collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)
    if law == 2:
        return alciatore.collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)
    if law == 3:
        return mass_spring.collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)
    return elastic.collide(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)


@compiled
def meet_cushion(s, nx, ny, radius, mass, p, law, gentle, out):  # type: ignore[no-untyped-def]
    """Fill out (7,) with the state s (7,) after a cushion with the unit normal (nx, ny) into it."""
    vn, vt = nx * s[2] + ny * s[3], nx * s[3] - ny * s[2]
    wn, wt, wz = nx * s[4] + ny * s[5], nx * s[5] - ny * s[4], s[6]
    out[0], out[1] = s[0], s[1]
    if gentle:
        vn = -vn
        out[0], out[1] = s[0] - DEPTH * nx, s[1] - DEPTH * ny
    else:
        vn, vt, wn, wt, wz = rebound(law, vn, vt, wn, wt, wz, radius, mass, p)
    out[2], out[3] = nx * vn - ny * vt, ny * vn + nx * vt
    out[4], out[5], out[6] = nx * wn - ny * wt, ny * wn + nx * wt, wz


@compiled
def meet_ball(a, b, ra, rb, ma, mb, p, law, gentle, out):  # type: ignore[no-untyped-def]
    """Fill out (14,) with the states a, b (7,) of two balls after they touched."""
    nx, ny = b[0] - a[0], b[1] - a[1]
    size = np.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    van, vat, vbn, vbt = nx * a[2] + ny * a[3], nx * a[3] - ny * a[2], nx * b[2] + ny * b[3], nx * b[3] - ny * b[2]
    wan, wat, wbn, wbt = nx * a[4] + ny * a[5], nx * a[5] - ny * a[4], nx * b[4] + ny * b[5], nx * b[5] - ny * b[4]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz = collide(
        0 if gentle else law, van, vat, wan, wat, a[6], vbn, vbt, wbn, wbt, b[6], ra, rb, ma, mb, p
    )
    back = DEPTH / (ma + mb) if gentle else 0.0 * ma
    out[0], out[1], out[7], out[8] = (
        a[0] - back * mb * nx,
        a[1] - back * mb * ny,
        b[0] + back * ma * nx,
        b[1] + back * ma * ny,
    )
    out[2], out[3], out[9], out[10] = nx * van - ny * vat, ny * van + nx * vat, nx * vbn - ny * vbt, ny * vbn + nx * vbt
    out[4], out[5], out[6] = nx * wan - ny * wat, ny * wan + nx * wat, waz
    out[11], out[12], out[13] = nx * wbn - ny * wbt, ny * wbn + nx * wbt, wbz
