"""Generic law of cushions beside any contact model, see `models.physics.effects.contacts.cushion_rebound`.

A change that would create energy, or leave the ball moving into the cushion, is left out.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards.contact_model import MAX_ENERGY_RATIO, sphere_energy
from models.physics.billiards.parameter_vector import REBOUND_PARAMETERS

_E_0, _E_1, _E_2, _GRIP_0, _GRIP_1, _ROLL = REBOUND_PARAMETERS


@compile_kernel
def change_rebound(vn, vt, wn, wt, wz, radius, p, after):  # type: ignore[no-untyped-def]
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
    restitution = p[_E_0] + p[_E_1] * vn + p[_E_2] * vt * vt / (vn * vn + vt * vt)
    along = -(p[_GRIP_0] + p[_GRIP_1] * vn / np.sqrt(vn * vn + slip * slip)) * slip
    changed = (
        after[0] - restitution * vn,
        after[1] + along,
        after[2],
        after[3] - p[_ROLL] * wt,
        after[4] + 2.5 / radius * along,
    )
    energy = sphere_energy(changed[0], changed[1], changed[2], changed[3], changed[4], radius)
    if changed[0].real > 0.0 or energy > MAX_ENERGY_RATIO * sphere_energy(vn, vt, wn, wt, wz, radius):
        return after
    return changed
