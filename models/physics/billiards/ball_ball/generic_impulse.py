"""Generic law of two balls beside any contact model, see `models.physics.effects.contacts.ball_impulse`.

A change that would create energy, or leave the balls moving into each other, is left out.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards.ball_ball.ball_contact import apply_ball_impulse, surface_slip
from models.physics.billiards.contact_model import MAX_ENERGY_RATIO, sphere_energy
from models.physics.billiards.parameter_vector import IMPULSE_PARAMETERS

_E_0, _E_1, _GRIP_0, _GRIP_1 = IMPULSE_PARAMETERS


@compile_kernel
def change_impulse(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p, after
):
    """Change velocities and spins after a contact of two balls by the generic law.

    Args and result are those of `ball_contact`; `after` are the ten numbers after the contact by a model. A parameter
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
    share = reduced * (p[_GRIP_0] + p[_GRIP_1] * closing / np.sqrt(closing * closing + st * st + sz * sz))
    a = apply_ball_impulse(
        after[0], after[1], after[2], after[3], after[4], after[5], after[6], after[7], after[8], after[9],
        ra, rb, ma, mb, reduced * (p[_E_0] + p[_E_1] * closing) * closing, -share * st, -share * sz,
    )  # fmt: skip
    energy = ma.real * sphere_energy(a[0], a[1], a[2], a[3], a[4], ra)
    energy += mb.real * sphere_energy(a[5], a[6], a[7], a[8], a[9], rb)
    limit = ma.real * sphere_energy(van, vat, wan, wat, waz, ra) + mb.real * sphere_energy(vbn, vbt, wbn, wbt, wbz, rb)
    if a[0].real > a[5].real or energy > MAX_ENERGY_RATIO * limit:
        return after
    return a
