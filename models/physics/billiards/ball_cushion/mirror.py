"""Cushion as a wall that touches the ball at the height of its centre: restitution, and Coulomb friction with spin.

The normal velocity is reversed and multiplied by e. Friction acts along the cushion against the slip there, at mu times
the normal impulse and at most at the impulse that stops the slip: 2/7 of it for a solid sphere. The vertical part of
the slip is ignored, because a ball that rolls straight at a real cushion keeps its roll (the nose is above the centre);
so a head-on ball without side spin returns with its spin unchanged.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_cushion.cushion_contact import CUSHION_PARAMETERS, restitution_at_speed
from models.physics.billiards.contact_model import ContactModel

_MU = parameter_vector.CUSHION_MU
_STICK = 2.0 / 7.0
"""Impulse per mass and slip that stops the slip of a solid sphere."""


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Return velocity and spin after the contact; arguments and result as in `cushion_contact`."""
    e = restitution_at_speed(vn, p)
    slip = vt + radius * wz
    size = np.sqrt(slip * slip + 1e-300)
    bound = p[_MU] * (1.0 + e) * vn
    share = bound / size if bound.real < _STICK * size.real else 0.0 * size + _STICK
    along = -share * slip
    return -e * vn, vt + along, wn + 0.0 * e, wt + 0.0 * e, wz + 2.5 / radius * along


MODEL = ContactModel(
    name="mirror",
    parameters=CUSHION_PARAMETERS,
    summary="A wall at the height of the ball's centre, with restitution and Coulomb friction",
    reference="Coulomb friction and restitution of Newton at the height of the centre; ours",
    resolve=rebound,
    rank=0,
)
