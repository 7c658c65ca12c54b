"""Ball against ball with a constant restitution (Newton) and a constant coefficient of friction (Coulomb).

Friction acts at mu times the normal impulse against the slip of the two surfaces, in the plane of the table and up or
down, but never reverses it (Walton 1993, in Particulate Two-Phase Flow, ch. 25).
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import STICKING_SHARE, ContactModel, apply_ball_impulse, surface_slip

_E = parameter_vector.BALL_E
_MU = parameter_vector.BALL_MU


@compile_kernel
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Return velocities and spins after the contact; arguments and result as in `ball_contact`."""
    reduced = ma * mb / (ma + mb)
    normal = (1.0 + p[_E]) * (van - vbn) * reduced
    st, sz = surface_slip(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    bound, stick = p[_MU] * normal, STICKING_SHARE * reduced
    share = bound / slip if bound.real < stick.real * slip.real else stick
    return apply_ball_impulse(
        van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, -share * st, -share * sz
    )


MODEL = ContactModel(
    name="inelastic",
    parameters=("ball_restitution.e", "ball_friction.mu"),
    summary="Constant restitution and a constant coefficient of friction",
    reference="Walton 1993, in Particulate Two-Phase Flow, chapter 25",
    resolve=collide,
    rank=1,
)
