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

Where three balls touch at once the springs overlap in time, which no sequence of impulses says; see
benchmarks/contact_laws.py.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards import parameters
from models.physics.billiards.ball_ball.ball_contact import STICK, exchange, slip_between

USES = ("ball_restitution.e", "ball_friction.mu")

STIFFNESS = 2.1e7
"""N/m: two balls of 0.17 kg touch for 0.2 ms, the order of Hertz's contact of phenolic balls at 1 m/s."""

_E = parameters.BALL_E
_MU = parameters.BALL_MU


@compiled
def damping_ratio(e):  # type: ignore[no-untyped-def]
    """d / (2 sqrt(k m)) for which half an oscillation returns the restitution e > 0."""
    log = np.log(e)
    return -log / np.sqrt(np.pi * np.pi + log * log)


@compiled
def duration(ma, mb, e):  # type: ignore[no-untyped-def]
    """How long two balls of masses ma, mb (kg) touch, s; the same at every speed, for the spring is linear."""
    ratio = damping_ratio(e)
    return np.pi * np.sqrt(ma * mb / (ma + mb) / STIFFNESS) / np.sqrt(1.0 - ratio * ratio)


@compiled
def pushing(e):  # type: ignore[no-untyped-def]
    """Impulse while the spring pushes, over the reduced mass and the closing speed: 1 + e, and what it pulls back."""
    ratio = damping_ratio(e)
    # The force is gone at the phase pi - 2 arcsin(z), where x' = -v exp(-z w0 t).
    root = np.sqrt(1.0 - ratio * ratio)
    angle = np.arcsin(ratio.real) + (ratio - ratio.real) / root
    return 1.0 + np.exp(-ratio / root * (np.pi - 2.0 * angle))


@compiled
def collide(  # type: ignore[no-untyped-def]
    van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p
):
    """Velocities (m/s) and spins (rad/s) of balls a and b after the contact, in the axes n, t, z."""
    e = p[_E]
    reduced = ma * mb / (ma + mb)
    through = reduced * (van - vbn)
    st, sz = slip_between(vat, wat, waz, vbt, wbt, wbz, ra, rb)
    slip = np.sqrt(st * st + sz * sz + 1e-300)
    bound, stick = p[_MU] * pushing(e + 1e-300) * through, STICK * reduced
    share = bound / slip if bound.real < stick.real * slip.real else stick
    normal = (1.0 + e) * through
    return exchange(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, normal, -share * st, -share * sz)
