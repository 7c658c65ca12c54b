"""Rigid cushion with Coulomb friction at the height of the nose: Han 2005.

I. Han, "Dynamics in carom and three cushion billiards", Journal of Mechanical Science and Technology 19 (2005) 976-984,
doi:10.1007/BF02919180. The normal impulse is (1 + e) times the closing speed along the contact's normal (eqs 14 to 17);
friction either stops the slip (sliding, then sticking, eq 18) or acts at mu times the normal impulse throughout
(forward sliding, eq 19), whichever is less (eq 20). The vertical velocity after the impact is dropped, as there.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import (
    CUSHION_PARAMETERS,
    NOSE_HEIGHT,
    NOSE_HEIGHT_PARAMETER,
    ContactModel,
    apply_cushion_impulse,
    contact_inclination,
    contact_velocities,
    restitution_at_speed,
)

_MU = parameter_vector.CUSHION_MU
# Impulse per mass and slip that stops the slip of a solid sphere.
_STICK = 2.0 / 7.0


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Return velocity and spin after the contact; arguments and result as in `contact_model`."""
    sine, cosine = contact_inclination(p, NOSE_HEIGHT)
    closing, st, sk = contact_velocities(vn, vt, wn, wt, wz, radius, sine, cosine)
    normal = (1.0 + restitution_at_speed(vn, p)) * closing
    slip = np.sqrt(st * st + sk * sk + 1e-300)
    friction = p[_MU] * normal
    share = friction / slip if friction.real < _STICK * slip.real else 0.0 * slip + _STICK
    return apply_cushion_impulse(vn, vt, wn, wt, wz, radius, normal, -share * st, -share * sk, sine, cosine)


MODEL = ContactModel(
    name="han_2005",
    parameters=CUSHION_PARAMETERS,
    summary="Rigid nose above the centre with Coulomb friction; the cloth is left out",
    reference="Han, Journal of Mechanical Science and Technology 19 (2005) 976-984, doi:10.1007/BF02919180",
    resolve=rebound,
    standard_values=((NOSE_HEIGHT_PARAMETER, NOSE_HEIGHT),),
    rank=1,
)
