"""Contacts of balls on the table: from the frame of the table into that of a contact model, and back.

Velocity and spin are rotated about the vertical, which rotates both as vectors. Gentle contacts (see
`models.numerics.roots`) have no loss and no friction whatever the model, and the overlap of a micrometre is removed: so
the next such contact comes after some time, and balls that press on each other do not creep into each other.

Beside any contact model there may be a generic law, see `models.physics.effects.contacts.ball_impulse` and
`cushion_rebound` beside it. A change that would create energy, or leave the bodies moving into each other, is left out.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.numerics.roots import CONTACT_DEPTH
from models.physics.billiards.contact_model import MAX_ENERGY_RATIO, apply_ball_impulse, sphere_energy, surface_slip
from models.physics.billiards.contact_models import GENTLE_MODEL, dispatch_ball_model, dispatch_cushion_model
from models.physics.billiards.parameter_vector import IMPULSE_PARAMETERS, REBOUND_PARAMETERS


@compile_kernel
def rebound(code, vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Resolve a contact with a cushion by the model of a code and the generic law.

    Args:
        code: Index in `CUSHION_MODELS`.
        vn: Velocity into the cushion, m/s.
        vt: Velocity along the cushion, m/s.
        wn: Spin about the normal, rad/s.
        wt: Spin about the direction along the cushion, rad/s.
        wz: Side spin, rad/s.
        radius: m.
        mass: kg.
        p: (P,) physical parameters.

    Returns:
        (vn, vt, wn, wt, wz) after the contact.
    """
    after = dispatch_cushion_model(code, vn, vt, wn, wt, wz, radius, mass, p)
    return _change_rebound(vn, vt, wn, wt, wz, radius, p, after)


@compile_kernel
def rebound_with_slip(code, before, radius, mass, p, after):  # type: ignore[no-untyped-def]
    """Resolve a contact with a cushion for a ball that is described by its slip.

    Args:
        code: Index in `CUSHION_MODELS`.
        before: (5,) velocity into and along the cushion, slip in the same directions, surface speed of side spin, m/s.
        radius: m.
        mass: kg.
        p: (P,) physical parameters.
        after: (5,) receives the same after the contact.
    """
    vn, vt, un, ut = before[0], before[1], before[2], before[3]
    wn, wt = (ut - vt) / radius, (vn - un) / radius
    vn, vt, wn, wt, wz = rebound(code, vn, vt, wn, wt, before[4] / radius, radius, mass, p)
    after[0], after[1], after[2], after[3], after[4] = vn, vt, vn - radius * wt, vt + radius * wn, radius * wz


@compile_kernel
def resolve_cushion_contact(s, nx, ny, radius, mass, p, code, gentle, out):  # type: ignore[no-untyped-def]
    """Write the state of a ball after a contact with a cushion.

    Args:
        s: (7,) state before: x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
        nx: x of the unit normal into the cushion.
        ny: y of that normal.
        radius: m.
        mass: kg.
        p: (P,) physical parameters.
        code: Index in `CUSHION_MODELS`.
        gentle: Whether the contact is gentle, see `models.numerics.roots`.
        out: (7,) receives the state after.
    """
    vn, vt = nx * s[2] + ny * s[3], nx * s[3] - ny * s[2]
    wn, wt, wz = nx * s[4] + ny * s[5], nx * s[5] - ny * s[4], s[6]
    out[0], out[1] = s[0], s[1]
    if gentle:
        vn = -vn
        out[0], out[1] = s[0] - CONTACT_DEPTH * nx, s[1] - CONTACT_DEPTH * ny
    else:
        vn, vt, wn, wt, wz = rebound(code, vn, vt, wn, wt, wz, radius, mass, p)
    out[2], out[3] = nx * vn - ny * vt, ny * vn + nx * vt
    out[4], out[5], out[6] = nx * wn - ny * wt, ny * wn + nx * wt, wz


@compile_kernel
def resolve_ball_contact(a, b, ra, rb, ma, mb, p, code, gentle, out):  # type: ignore[no-untyped-def]
    """Write the states of two balls after they touched.

    Args:
        a: (7,) state of the first ball before: x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
        b: (7,) state of the second ball.
        ra: Radius of the first ball, m.
        rb: Radius of the second ball, m.
        ma: Mass of the first ball, kg.
        mb: Mass of the second ball, kg.
        p: (P,) physical parameters.
        code: Index in `BALL_MODELS`.
        gentle: Whether the contact is gentle, see `models.numerics.roots`.
        out: (14,) receives both states after.
    """
    nx, ny = b[0] - a[0], b[1] - a[1]
    size = np.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    van, vat, vbn, vbt = nx * a[2] + ny * a[3], nx * a[3] - ny * a[2], nx * b[2] + ny * b[3], nx * b[3] - ny * b[2]
    wan, wat, wbn, wbt = nx * a[4] + ny * a[5], nx * a[5] - ny * a[4], nx * b[4] + ny * b[5], nx * b[5] - ny * b[4]
    after = dispatch_ball_model(
        GENTLE_MODEL if gentle else code, van, vat, wan, wat, a[6], vbn, vbt, wbn, wbt, b[6], ra, rb, ma, mb, p
    )
    if not gentle:
        after = _change_impulse(van, vat, wan, wat, a[6], vbn, vbt, wbn, wbt, b[6], ra, rb, ma, mb, p, after)
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz = after
    back = CONTACT_DEPTH / (ma + mb) if gentle else 0.0 * ma
    out[0], out[1], out[7], out[8] = (
        a[0] - back * mb * nx,
        a[1] - back * mb * ny,
        b[0] + back * ma * nx,
        b[1] + back * ma * ny,
    )
    out[2], out[3], out[9], out[10] = nx * van - ny * vat, ny * van + nx * vat, nx * vbn - ny * vbt, ny * vbn + nx * vbt
    out[4], out[5], out[6] = nx * wan - ny * wat, ny * wan + nx * wat, waz
    out[11], out[12], out[13] = nx * wbn - ny * wbt, ny * wbn + nx * wbt, wbz


_IMPULSE_E_0, _IMPULSE_E_1, _IMPULSE_GRIP_0, _IMPULSE_GRIP_1 = IMPULSE_PARAMETERS


@compile_kernel
def _change_impulse(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p, after
):
    """Change velocities and spins after a contact of two balls by the generic law.

    Args and result are those of a ball model; `after` are the ten numbers after the contact by a model. A parameter
    that carries only a derivative counts too.
    """
    acts = False
    for parameter in IMPULSE_PARAMETERS:
        if p[parameter] != 0:
            acts = True
    if not acts:
        return after
    reduced, closing = ma * mb / (ma + mb), van - vbn
    st, sz = surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    grip = p[_IMPULSE_GRIP_0] + p[_IMPULSE_GRIP_1] * closing / np.sqrt(closing * closing + st * st + sz * sz)
    share = reduced * grip
    a = apply_ball_impulse(
        after[0], after[1], after[2], after[3], after[4], after[5], after[6], after[7], after[8], after[9],
        ra, rb, ma, mb, reduced * (p[_IMPULSE_E_0] + p[_IMPULSE_E_1] * closing) * closing, -share * st, -share * sz,
    )  # fmt: skip
    energy = ma.real * sphere_energy(a[0], a[1], a[2], a[3], a[4], ra)
    energy += mb.real * sphere_energy(a[5], a[6], a[7], a[8], a[9], rb)
    limit = ma.real * sphere_energy(van, vat, wan, wat, waz, ra) + mb.real * sphere_energy(vbn, vbt, wbn, wbt, wbz, rb)
    if a[0].real > a[5].real or energy > MAX_ENERGY_RATIO * limit:
        return after
    return a


_REBOUND_E_0, _REBOUND_E_1, _REBOUND_E_2, _REBOUND_GRIP_0, _REBOUND_GRIP_1, _REBOUND_ROLL = REBOUND_PARAMETERS


@compile_kernel
def _change_rebound(vn, vt, wn, wt, wz, radius, p, after):  # type: ignore[no-untyped-def]
    """Change velocity and spin after a contact with a cushion by the generic law.

    Args:
        vn: Velocity into the cushion before the contact, m/s.
        vt: Velocity along the cushion, m/s.
        wn: Spin about the normal, rad/s.
        wt: Spin about the direction along the cushion, rad/s.
        wz: Side spin, rad/s.
        radius: m.
        p: (P,) physical parameters; a parameter that carries only a derivative counts too.
        after: The same five numbers after the contact by a model.

    Returns:
        The five numbers after the contact.
    """
    acts = False
    for parameter in REBOUND_PARAMETERS:
        if p[parameter] != 0:
            acts = True
    if not acts:
        return after
    slip = vt + radius * wz
    restitution = p[_REBOUND_E_0] + p[_REBOUND_E_1] * vn + p[_REBOUND_E_2] * vt * vt / (vn * vn + vt * vt)
    along = -(p[_REBOUND_GRIP_0] + p[_REBOUND_GRIP_1] * vn / np.sqrt(vn * vn + slip * slip)) * slip
    changed = (
        after[0] - restitution * vn,
        after[1] + along,
        after[2],
        after[3] - p[_REBOUND_ROLL] * wt,
        after[4] + 2.5 / radius * along,
    )
    energy = sphere_energy(changed[0], changed[1], changed[2], changed[3], changed[4], radius)
    if changed[0].real > 0.0 or energy > MAX_ENERGY_RATIO * sphere_energy(vn, vt, wn, wt, wz, radius):
        return after
    return changed
