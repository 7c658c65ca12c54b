"""What accelerates a ball on the cloth: friction against its slip, rolling resistance with nap, slope and drag."""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards.cloth.motion_pieces import GLIDE, SLIDE
from models.physics.billiards.parameters import (
    AIR_DRAG,
    GRAVITY,
    NAP,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    VISCOUS_DRAG,
)

ROLLED = 5.0 / 7.0
"""Of a force along the cloth accelerates a solid sphere that rolls."""


@compiled
def curved(p):  # type: ignore[no-untyped-def]
    """Whether an effect acts that has no closed form; also where only its derivative is asked for."""
    return p[SLOPE_X] != 0 or p[SLOPE_Y] != 0 or p[AIR_DRAG] != 0 or p[VISCOUS_DRAG] != 0


@compiled
def slip(s, radius):  # type: ignore[no-untyped-def]
    """Velocity of the point that touches the cloth, and its size; s is x, y, vx, vy, wx, wy."""
    ux, uy = s[2] - radius * s[5], s[3] + radius * s[4]
    return ux, uy, np.sqrt(ux * ux + uy * uy)


@compiled
def heading(vx, vy):  # type: ignore[no-untyped-def]
    """Unit vector along a velocity, and the speed."""
    speed = np.sqrt(vx * vx + vy * vy)
    if speed.real == 0.0:
        return 0.0 * speed, 0.0 * speed, speed
    return vx / speed, vy / speed, speed


@compiled
def resistance(hx, p):  # type: ignore[no-untyped-def]
    """Deceleration of a ball that rolls with hx = cos(angle to +x), m/s^2."""
    return (p[ROLLING_MU] - p[NAP] * hx) * GRAVITY


@compiled
def pull(vx, vy, p):  # type: ignore[no-untyped-def]
    """What slope and drag do to the centre of a ball that slides, m/s^2."""
    drag = p[AIR_DRAG] * np.sqrt(vx * vx + vy * vy) + p[VISCOUS_DRAG]
    return GRAVITY * 1e-3 * p[SLOPE_X] - drag * vx, GRAVITY * 1e-3 * p[SLOPE_Y] - drag * vy


@compiled
def accelerate(s, radius, p, phase, rate):  # type: ignore[no-untyped-def]
    """Fill rate (6,) with the time derivative of s (6,): x, y, vx, vy, wx, wy."""
    rate[0], rate[1] = s[2], s[3]
    if phase == SLIDE:
        ux, uy, size = slip(s, radius)
        bx, by = pull(s[2], s[3], p)
        fx, fy = -p[SLIDING_MU] * GRAVITY * ux / size, -p[SLIDING_MU] * GRAVITY * uy / size
        rate[2], rate[3] = fx + bx, fy + by
        rate[4], rate[5] = 2.5 / radius * fy, -2.5 / radius * fx
        return
    hx, hy, speed = heading(s[2], s[3])
    drag, tilt = p[AIR_DRAG] * speed + p[VISCOUS_DRAG], ROLLED * GRAVITY * 1e-3
    slow = resistance(hx, p)
    rate[2] = -slow * hx + tilt * p[SLOPE_X] - drag * s[2]
    rate[3] = -slow * hy + tilt * p[SLOPE_Y] - drag * s[3]
    rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    if phase == GLIDE:
        rate[4:6] = 0.0
