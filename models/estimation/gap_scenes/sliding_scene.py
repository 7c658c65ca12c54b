"""A body that slides on a plane, for the diagnosis: no force acts on it unless the simulator has it."""

from __future__ import annotations

import numpy as np

from models.estimation.gap_scenes.contact_free_scene import (
    ContactFreeScene,
    RealOrComplexArray,
    SceneEffect,
    build_brake_probe,
    build_integrator,
)
from models.numerics.jit import compile_kernel
from models.physics.effect import Prior

GRAVITY = 9.81
"""m/s^2"""
FRICTION_FADE_SPEED = 0.01
"""m/s at which friction fades out."""
_STICK_SHARE = 0.98
"""Slope over mu up to which a stopped body sticks."""

SLIDING_EFFECTS = (
    SceneEffect(
        "sliding_friction", (Prior("mu", "1", 0.2, 0.2, False, (0.0, 2.0)),), (0.0,), ("slide",),
        "Coulomb 1785: a = -mu g, independent of speed", ("viscous_drag",),
    ),
    SceneEffect(
        "viscous_drag", (Prior("k", "1/s", 0.0, 1.0, False, (0.0, 50.0)),), (0.0,), ("slide",),
        "a = -k v: a lubricated contact", ("sliding_friction", "air_drag"),
    ),
    SceneEffect(
        "air_drag", (Prior("k", "1/m", 0.0, 0.3, False, (0.0, 20.0)),), (0.0,), ("slide",),
        "a = -k v v", ("viscous_drag",),
    ),
    SceneEffect(
        "slope", (Prior("slope_x", "mm/m", 0.0, 10.0, False, (-200.0, 200.0)),
                  Prior("slope_y", "mm/m", 0.0, 10.0, False, (-200.0, 200.0))), (0.0, 0.0), ("slide",),
        "g times the slope, in the downhill direction", ("sliding_friction",),
    ),
    build_brake_probe("m", "slide"),
)  # fmt: skip


@compile_kernel
def sliding_acceleration(
    place: RealOrComplexArray, velocity: RealOrComplexArray, p: RealOrComplexArray, out: RealOrComplexArray
) -> None:
    """Fill the acceleration by friction, drags and slope, with parameters in the order of `SLIDING_EFFECTS`.

    Friction fades out at the velocity where it balances the slope, not at zero velocity, so that a stopped body does
    not creep.
    """
    square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    speed = np.sqrt(square + FRICTION_FADE_SPEED**2)
    brake = p[1] + p[2] * speed
    fall_x, fall_y = GRAVITY * 1e-3 * p[3], GRAVITY * 1e-3 * p[4]
    friction = p[0] * GRAVITY
    rubbed_x, rubbed_y = velocity[0], velocity[1]
    holds = friction * friction - fall_x * fall_x - fall_y * fall_y
    if holds.real > (1 - _STICK_SHARE**2) * (friction * friction).real:
        lean = FRICTION_FADE_SPEED / np.sqrt(holds) * np.exp(-square / FRICTION_FADE_SPEED**2)
        rubbed_x, rubbed_y = rubbed_x + lean * fall_x, rubbed_y + lean * fall_y
        speed = np.sqrt(rubbed_x * rubbed_x + rubbed_y * rubbed_y + FRICTION_FADE_SPEED**2)
    out[0] = fall_x - brake * velocity[0] - friction * rubbed_x / speed
    out[1] = fall_y - brake * velocity[1] - friction * rubbed_y / speed


def build_sliding_scene(simulator_effects: tuple[str, ...] = ()) -> ContactFreeScene:
    """Build the scene of a simulator with some of the effects.

    Args:
        simulator_effects: Names of the effects that the simulator has.

    Returns:
        The scene.
    """
    return ContactFreeScene(
        "slide",
        "m",
        "slide",
        SLIDING_EFFECTS,
        simulator_effects,
        build_integrator(sliding_acceleration, True),
        ("lens_distortion", "perspective"),
    )
