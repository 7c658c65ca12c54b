"""Ball against ball without loss and friction: equal balls exchange their velocities along the line of centres."""

from __future__ import annotations

from models.numerics.jit import compile_kernel
from models.physics.billiards.contact_model import ContactModel, apply_ball_impulse


@compile_kernel
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Return velocities and spins after the contact; arguments and result as in `contact_model`."""
    normal = 2.0 * (van - vbn) * ma * mb / (ma + mb)
    none = 0.0 * p[0]
    return apply_ball_impulse(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, none, none)


MODEL = ContactModel(
    name="elastic",
    parameters=(),
    summary="No loss and no friction",
    reference="Newton's law of impact with restitution 1",
    resolve=collide,
    rank=0,
)
