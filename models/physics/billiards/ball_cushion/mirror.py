"""Cushion as a wall that touches the ball, by default at the height of its centre: restitution, and Coulomb friction.

The normal velocity is reversed and multiplied by e. Friction acts along the cushion against the slip there, at mu times
the normal impulse and at most at the impulse that stops the slip: 2/7 of it for a solid sphere. The vertical part of
the slip is ignored, because a ball that rolls straight at a real cushion keeps its roll (the nose is above the centre);
so a head-on ball without side spin returns with its spin unchanged.

With another `cushion_height` the contact is there, and its normal leans by theta. The horizontal normal speed is still
multiplied by -e, so the normal impulse of the nose is (1 + e) vn / cos(theta); the cloth takes its vertical part
without friction, and the ball stays down. That impulse bounds the friction along the cushion, and the slip is that of
the point of contact: vt + R (wz cos(theta) - wn sin(theta)). The vertical part of the slip is ignored as before.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import (
    CUSHION_PARAMETERS,
    NOSE_HEIGHT_PARAMETER,
    ContactModel,
    contact_inclination,
    restitution_at_speed,
)

# Height of the centre above the cloth over the radius.
CENTRE_HEIGHT = 1.0

_MU = parameter_vector.CUSHION_MU
# Impulse per mass and slip that stops the slip of a solid sphere.
_STICK = 2.0 / 7.0


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Return velocity and spin after the contact; arguments and result as in `contact_model`."""
    e = restitution_at_speed(vn, p)
    sine, cosine = contact_inclination(p, CENTRE_HEIGHT)
    slip = vt + radius * (cosine * wz - sine * wn)
    size = np.sqrt(slip * slip + 1e-300)
    bound = p[_MU] * (1.0 + e) * vn / cosine
    share = bound / size if bound.real < _STICK * size.real else 0.0 * size + _STICK
    along = -share * slip
    spin = 2.5 / radius
    return -e * vn, vt + along, wn + 0.0 * e - sine * spin * along, wt + 0.0 * e, wz + cosine * spin * along


MODEL = ContactModel(
    name="mirror",
    parameters=CUSHION_PARAMETERS,
    summary="A wall, by default at the height of the ball's centre, with restitution and Coulomb friction",
    reference="Coulomb friction and restitution of Newton at the height of the centre; ours",
    resolve=rebound,
    standard_values=((NOSE_HEIGHT_PARAMETER, CENTRE_HEIGHT),),
    rank=0,
)
