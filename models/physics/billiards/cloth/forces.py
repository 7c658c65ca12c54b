"""Accelerations of a ball on the cloth: friction against its slip, rolling resistance with nap, slope and drag."""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.motion_pieces import GLIDE, SLIDE
from models.physics.billiards.parameter_vector import (
    AIR_DRAG,
    GRAVITY,
    NAP_MU,
    PATH_BENDING_PARAMETERS,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    VISCOUS_DRAG,
)

ROLLING_SHARE = 5.0 / 7.0
"""Part of a force along the cloth that accelerates the centre of a solid sphere that rolls."""


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
def slope_and_drag(vx, vy, p):  # type: ignore[no-untyped-def]
    """Return the acceleration (m/s^2) of the centre of a sliding ball at (vx, vy) m/s by slope and drag."""
    drag = p[AIR_DRAG] * np.sqrt(vx * vx + vy * vy) + p[VISCOUS_DRAG]
    return GRAVITY * 1e-3 * p[SLOPE_X] - drag * vx, GRAVITY * 1e-3 * p[SLOPE_Y] - drag * vy


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
    drag, tilt = p[AIR_DRAG] * speed + p[VISCOUS_DRAG], ROLLING_SHARE * GRAVITY * 1e-3
    slow = rolling_deceleration(hx, p)
    rate[2] = -slow * hx + tilt * p[SLOPE_X] - drag * s[2]
    rate[3] = -slow * hy + tilt * p[SLOPE_Y] - drag * s[3]
    rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    if phase == GLIDE:
        rate[4:6] = 0.0
