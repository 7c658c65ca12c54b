"""A body that slides on a plane, for the diagnosis: nothing acts on it unless the simulator has it."""

from __future__ import annotations

import numpy as np

from models.billiards.compiled import compiled
from models.effects.effect import Prior
from models.smooth_motion import Numbers, SceneEffect, SmoothScene, brake_probe, marcher

GRAVITY = 9.81
"""m/s2"""
SLOW = 0.01
"""m/s at which friction fades out: a body at rest creeps by this times slope over mu, 0.1 mm in a second on 2 mm/m."""

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
    """Acceleration by friction, drags and slope, in the order of EFFECTS."""
    speed = np.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + SLOW**2)
    brake = p[0] * GRAVITY / speed + p[1] + p[2] * speed
    out[0] = -brake * velocity[0] + GRAVITY * 1e-3 * p[3]
    out[1] = -brake * velocity[1] + GRAVITY * 1e-3 * p[4]


def slide_scene(assumed: tuple[str, ...] = ()) -> SmoothScene:
    """The scene for a simulator that has the effects `assumed`."""
    return SmoothScene(
        "slide", "m", "slide", EFFECTS, assumed, marcher(force, True), ("lens_distortion", "perspective")
    )
