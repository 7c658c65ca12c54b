"""Ball against ball with a friction that falls with the speed of the slip: Alciatore's technical proof A-14.

D. G. Alciatore, "The effects of cut angle, speed, and spin on object ball throw", technical proof A-14 (2006,
billiards.colostate.edu/technical_proofs): mu = 0.00995 + 0.108 exp(-1.088 v), v in m/s the relative speed of the two
surfaces when they meet, fitted to the measurements of Marlow (The Physics of Pocket Billiards, 1995). Friction acts at
mu times the normal impulse against the slip, in the plane of the table and up or down, but never reverses it: an
impulse below that bound is enough once the surfaces run as gears (technical proof A-6: 1/7 of the slip for equal
balls).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import ContactModel, rub_balls, surface_slip

# Coefficient of friction at high speed.
FRICTION_AT_SPEED = 0.00995
# Increase of the coefficient at speed 0.
FRICTION_RISE = 0.108
# s/m, rate at which that increase falls with speed.
FRICTION_DECAY = 1.088

_E = parameter_vector.BALL_E


@compile_kernel
def friction_coefficient(slip):  # type: ignore[no-untyped-def]
    """Return the coefficient of friction at the relative speed `slip` (m/s) of the two surfaces."""
    return FRICTION_AT_SPEED + FRICTION_RISE * np.exp(-FRICTION_DECAY * slip)


@compile_kernel
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Return velocities and spins after the contact; arguments and result as in `contact_model`."""
    normal = (1.0 + p[_E]) * (van - vbn) * ma * mb / (ma + mb)
    st, sz = surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    friction = friction_coefficient(slip) * normal
    return rub_balls(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, friction)


MODEL = ContactModel(
    name="alciatore",
    parameters=("ball_restitution.e",),
    summary="Constant restitution and friction that falls with the speed of the slip",
    reference="Alciatore 2006, technical proof A-14, billiards.colostate.edu/technical_proofs",
    resolve=collide,
    rank=2,
)
