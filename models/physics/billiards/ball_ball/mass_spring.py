"""Ball against ball through a very stiff spring and a damper at the point of impact: Chen 2022, section 2.1.

While two balls overlap by x they push each other with k x + d x' along the line of centres (Chen 2022, eqs 1 to 6, with
the distance of touching balls as the resting length). For the pair alone that is a damped oscillator of the reduced
mass m, and the contact its first half oscillation, in closed form: with the damping ratio z = d / (2 sqrt(k m)),

    x(t) = v / w exp(-z w0 t) sin(w t),   w0 = sqrt(k / m),   w = w0 sqrt(1 - z^2),   until t = pi / w,

after which the balls part at e v with e = exp(-pi z / sqrt(1 - z^2)): the damper follows from the restitution, and the
stiffness sets the duration alone. `collide` therefore maps the contact to an impulse at its start. What that leaves out
over the 0.2 ms, in a half-ball hit at 2 m/s: the line of centres turns by 0.1 degrees, and the balls end up some 0.2 mm
from where an impulse sends them. The spring pulls at the very end (k x + d x' < 0); that is the thesis' model, and its
share of the impulse is 3e-4 at e = 0.95. Friction acts against the slip at mu times the force while the spring pushes.

Where three balls touch at once the springs overlap in time, which no sequence of impulses represents; see
benchmarks/physics/contact_models.py.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import ContactModel, rub_balls

# N/m: two balls of 0.17 kg touch for 0.2 ms, the order of Hertz's contact of phenolic balls at 1 m/s.
STIFFNESS = 2.1e7

_E = parameter_vector.BALL_E
_MU = parameter_vector.BALL_MU


@compile_kernel
def damping_ratio(e):  # type: ignore[no-untyped-def]
    """Return d / (2 sqrt(k m)) for which half an oscillation has the restitution e > 0."""
    log = np.log(e)
    return -log / np.sqrt(np.pi * np.pi + log * log)


@compile_kernel
def contact_duration(ma, mb, e):  # type: ignore[no-untyped-def]
    """Return the time (s) that two balls of masses ma, mb (kg) touch, the same at every speed for a linear spring."""
    ratio = damping_ratio(e)
    return np.pi * np.sqrt(ma * mb / (ma + mb) / STIFFNESS) / np.sqrt(1.0 - ratio * ratio)


@compile_kernel
def pushing_impulse(e):  # type: ignore[no-untyped-def]
    """Return the impulse while the spring pushes over reduced mass and closing speed: 1 + e and the later pull."""
    ratio = damping_ratio(e)
    # The force is 0 at the phase pi - 2 arcsin(z), where x' = -v exp(-z w0 t).
    root = np.sqrt(1.0 - ratio * ratio)
    angle = np.arcsin(ratio.real) + (ratio - ratio.real) / root
    return 1.0 + np.exp(-ratio / root * (np.pi - 2.0 * angle))


@compile_kernel
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Return velocities and spins after the contact; arguments and result as in `contact_model`."""
    e = p[_E]
    through = ma * mb / (ma + mb) * (van - vbn)
    normal, friction = (1.0 + e) * through, p[_MU] * pushing_impulse(e + 1e-300) * through
    return rub_balls(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, friction)


MODEL = ContactModel(
    name="mass_spring",
    parameters=("ball_restitution.e", "ball_friction.mu"),
    summary="A stiff spring and a damper at the point of impact",
    reference="Chen 2022, section 2.1, equations 1 to 6",
    resolve=collide,
    is_candidate=False,  # the outcome for a pair of balls is close to that of `inelastic`
    rank=3,
)
