"""A body that slides on a plane, for the diagnosis: nothing acts on it unless the simulator has it."""

from __future__ import annotations

import numpy as np

from models.estimation.gap_scenes.contact_free_scene import Numbers, SceneEffect, SmoothScene, brake_probe, marcher
from models.numerics.jit import compiled
from models.physics.effect import Prior

GRAVITY = 9.81
"""m/s2"""
SLOW = 0.01
"""m/s at which friction fades out."""
_HELD = 0.98
"""slope over mu up to which a body that has stopped stays where it is."""

EFFECTS = (
    SceneEffect(
        "sliding_friction", (Prior("mu", "1", 0.2, 0.2, False, (0.0, 2.0)),), (0.0,), ("slide",),
        "Coulomb 1785: a = -mu g, at all speeds alike", ("viscous_drag",),
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
        "g times the slope, towards where the plane falls", ("sliding_friction",),
    ),
    brake_probe("m", "slide"),
)  # fmt: skip


@compiled
def force(place: Numbers, velocity: Numbers, p: Numbers, out: Numbers) -> None:
    """Acceleration by friction, drags and slope, in the order of EFFECTS; friction fades out where it balances the
    slope, not where the body rests, so that what has stopped does not creep."""
    square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    speed = np.sqrt(square + SLOW**2)
    brake = p[1] + p[2] * speed
    fall_x, fall_y = GRAVITY * 1e-3 * p[3], GRAVITY * 1e-3 * p[4]
    friction = p[0] * GRAVITY
    rubbed_x, rubbed_y = velocity[0], velocity[1]
    holds = friction * friction - fall_x * fall_x - fall_y * fall_y
    if holds.real > (1 - _HELD**2) * (friction * friction).real:
        lean = SLOW / np.sqrt(holds) * np.exp(-square / SLOW**2)
        rubbed_x, rubbed_y = rubbed_x + lean * fall_x, rubbed_y + lean * fall_y
        speed = np.sqrt(rubbed_x * rubbed_x + rubbed_y * rubbed_y + SLOW**2)
    out[0] = fall_x - brake * velocity[0] - friction * rubbed_x / speed
    out[1] = fall_y - brake * velocity[1] - friction * rubbed_y / speed


def slide_scene(assumed: tuple[str, ...] = ()) -> SmoothScene:
    """The scene for a simulator that has the effects `assumed`."""
    return SmoothScene(
        "slide", "m", "slide", EFFECTS, assumed, marcher(force, True), ("lens_distortion", "perspective")
    )
