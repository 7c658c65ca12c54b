"""Ball against ball with a constant restitution (Newton) and a constant coefficient of friction (Coulomb).

Friction acts at mu times the normal impulse against the slip of the two surfaces, in the plane of the table and up or
down, but never reverses it (Walton 1993, in Particulate Two-Phase Flow, ch. 25).
"""

from __future__ import annotations

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import ContactModel, rub_balls

_E = parameter_vector.BALL_E
_MU = parameter_vector.BALL_MU


@compile_kernel
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Return velocities and spins after the contact; arguments and result as in `contact_model`."""
    normal = (1.0 + p[_E]) * (van - vbn) * ma * mb / (ma + mb)
    return rub_balls(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, p[_MU] * normal)


MODEL = ContactModel(
    name="inelastic",
    parameters=("ball_restitution.e", "ball_friction.mu"),
    summary="Constant restitution and a constant coefficient of friction",
    reference="Walton 1993, in Particulate Two-Phase Flow, chapter 25",
    resolve=collide,
    rank=1,
)
