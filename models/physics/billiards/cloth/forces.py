"""Accelerations of a ball on the cloth: friction against its slip, rolling resistance with nap, slope and drag.

The generic law of the cloth adds its pull to the slope, its brake to the drag, and turns the motion to the left.
"""

from __future__ import annotations

import numpy as np

from models.core.constants import GRAVITY
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.motion_pieces import GLIDE, SLIDE
from models.physics.billiards.parameter_vector import (
    AIR_DRAG,
    BRAKE_1,
    BRAKE_2,
    BRAKE_3,
    NAP_MU,
    PATH_BENDING_PARAMETERS,
    PULL_X,
    PULL_Y,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    TURN_0,
    TURN_1,
    VISCOUS_DRAG,
)

# Part of a force along the cloth that accelerates the centre of a solid sphere that rolls.
ROLLING_SHARE = 5.0 / 7.0
# m/s below which the constant part of the generic turn vanishes.
TURN_FADE_SPEED = 0.02


@compile_kernel
def has_curved_path(p):  # type: ignore[no-untyped-def]
    """Whether paths have no closed form.

    Args:
        p: (P,) physical parameters; a parameter that carries only a derivative counts too.

    Returns:
        True where an effect that bends the path is present.
    """
    for parameter in PATH_BENDING_PARAMETERS:  # noqa: SIM110 - numba compiles no generator expression
        if p[parameter] != 0:
            return True
    return False


@compile_kernel
def contact_slip(s, radius):  # type: ignore[no-untyped-def]
    """Compute the velocity of the point that touches the cloth.

    Args:
        s: (6,) or longer: x, y (m), vx, vy (m/s), wx, wy (rad/s).
        radius: m.

    Returns:
        Its x and y components and its magnitude, m/s.
    """
    ux, uy = s[2] - radius * s[5], s[3] + radius * s[4]
    return ux, uy, np.sqrt(ux * ux + uy * uy)


@compile_kernel
def travel_direction(vx, vy):  # type: ignore[no-untyped-def]
    """Compute the direction of a velocity.

    Args:
        vx: m/s.
        vy: m/s.

    Returns:
        x and y of the unit vector, 0 at rest, and the speed, m/s.
    """
    speed = np.sqrt(vx * vx + vy * vy)
    if speed.real == 0.0:
        return 0.0 * speed, 0.0 * speed, speed
    return vx / speed, vy / speed, speed


@compile_kernel
def rolling_deceleration(hx, p):  # type: ignore[no-untyped-def]
    """Return the deceleration (m/s^2) of a ball that rolls with hx = cos(angle to +x)."""
    return (p[ROLLING_MU] - p[NAP_MU] * hx) * GRAVITY


@compile_kernel
def downhill_slope(p):  # type: ignore[no-untyped-def]
    """Return x and y (mm/m) of the slope and the generic pull."""
    return p[SLOPE_X] + p[PULL_X], p[SLOPE_Y] + p[PULL_Y]


@compile_kernel
def drag_and_turn(speed, slow, p):  # type: ignore[no-untyped-def]
    """Compute the deceleration and the turn of a ball over its speed.

    Args:
        speed: m/s.
        slow: Deceleration by rolling resistance, m/s^2; the generic brake offsets at most this and the drag.
        p: (P,) physical parameters.

    Returns:
        Deceleration by drag and the generic brake, and acceleration to the left, both over the speed, 1/s.
    """
    drag = p[AIR_DRAG] * speed + p[VISCOUS_DRAG] + (p[BRAKE_1] + speed * (p[BRAKE_2] + speed * p[BRAKE_3]))
    if drag.real * speed.real < -slow.real:
        drag = -slow / speed
    return drag, p[TURN_0] / np.sqrt(speed * speed + TURN_FADE_SPEED * TURN_FADE_SPEED) + p[TURN_1]


@compile_kernel
def slope_and_drag(vx, vy, p):  # type: ignore[no-untyped-def]
    """Return the acceleration (m/s^2) of a sliding ball at (vx, vy) m/s by all but sliding friction."""
    speed = np.sqrt(vx * vx + vy * vy)
    (sx, sy), (drag, turn) = downhill_slope(p), drag_and_turn(speed, p[ROLLING_MU] * GRAVITY, p)
    return GRAVITY * 1e-3 * sx - drag * vx - turn * vy, GRAVITY * 1e-3 * sy - drag * vy + turn * vx


@compile_kernel
def evaluate_state_rate(s, radius, p, phase, rate):  # type: ignore[no-untyped-def]
    """Evaluate the time derivative of the state of a ball.

    Args:
        s: (6,) or longer: x, y (m), vx, vy (m/s), wx, wy (rad/s).
        radius: m.
        p: (P,) physical parameters.
        phase: One of the phases of `motion_pieces`.
        rate: (6,) receives the derivative.
    """
    rate[0], rate[1] = s[2], s[3]
    if phase == SLIDE:
        ux, uy, size = contact_slip(s, radius)
        bx, by = slope_and_drag(s[2], s[3], p)
        fx, fy = -p[SLIDING_MU] * GRAVITY * ux / size, -p[SLIDING_MU] * GRAVITY * uy / size
        rate[2], rate[3] = fx + bx, fy + by
        rate[4], rate[5] = 2.5 / radius * fy, -2.5 / radius * fx
        return
    hx, hy, speed = travel_direction(s[2], s[3])
    slow, tilt = rolling_deceleration(hx, p), ROLLING_SHARE * GRAVITY * 1e-3
    (sx, sy), (drag, turn) = downhill_slope(p), drag_and_turn(speed, slow, p)
    rate[2] = -slow * hx + tilt * sx - drag * s[2] - turn * s[3]
    rate[3] = -slow * hy + tilt * sy - drag * s[3] + turn * s[2]
    rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    if phase == GLIDE:
        rate[4], rate[5] = 0.0, 0.0
