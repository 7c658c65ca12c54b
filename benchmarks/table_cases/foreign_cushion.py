"""A cushion of no published form, integrated by small steps; it shares no code with the contact models.

The nose is a leaning pad: a spring that hardens with its compression and loses more of it the deeper it was. It drags
the surface of the ball with friction that falls with the slip (Stribeck), and gives way upwards. The shares of speed
and roll that are left depend on speed, angle and spin as in no published model with constant coefficients.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# rad, from the horizontal to the line from the ball's centre to the nose.
LEAN = 0.3
# 1/s^2, and 1/(s^2 m): force over mass of a compression, and its growth.
STIFFNESS, HARDENING = 4.0e5, 8.0e7
# Force of a nose that recovers over that of one that is compressed, and its loss per deepest compression, 1/m.
RECOVERY, TIRING = 0.86, 35.0
# Friction of fast slip, its relative excess at slow slip, the speed of its decay in m/s, and the share of upward drag
# by which the nose gives way.
SLIPPING, STRIBECK, SCALE, GIVE = 0.12, 2.0, 0.6, 0.35
# s; a contact ends long before.
STEP, STEPS = 4e-5, 500


def rebound_from_pad(before: Floats) -> Floats:
    """Integrate contacts.

    Args:
        before: (K, 5) velocity along n and t, slip along n and t, surface speed of side spin, m/s.

    Returns:
        (K, 5) the same after the contact.
    """
    vn, vt, un, ut, side = (before[:, k].copy() for k in range(5))
    roll, cross = vn - un, ut - vt  # surface speeds of the spins about t and n
    depth, deepest, over = np.zeros(len(before)), np.zeros(len(before)), np.zeros(len(before), bool)
    cos, sin = np.cos(LEAN), np.sin(LEAN)
    for _ in range(STEPS):
        depth = depth + STEP * vn * cos
        over |= depth <= 0
        deepest = np.maximum(deepest, depth)
        force = np.where(over, 0.0, (STIFFNESS + HARDENING * depth) * np.maximum(depth, 0.0))
        force = np.where(depth < deepest, (RECOVERY - TIRING * deepest) * force, force)
        along, up = vt + cos * side - sin * cross, -sin * vn - roll  # slip of the surface at the nose
        size = np.hypot(along, up) + 1e-9
        drag = np.minimum(SLIPPING * (1 + STRIBECK * np.exp(-size / SCALE)) * force, size / (3.5 * STEP))
        drag_t, drag_k = drag * along / size, (1 - GIVE) * drag * up / size
        vn = vn - STEP * (cos * force - sin * drag_k)
        vt = vt - STEP * drag_t
        side, cross = side - 2.5 * STEP * cos * drag_t, cross + 2.5 * STEP * sin * drag_t
        roll = roll + 2.5 * STEP * drag_k
    vn = np.minimum(vn, -1e-3)
    return np.stack([vn, vt, vn - roll, vt + cross, side], axis=1)
