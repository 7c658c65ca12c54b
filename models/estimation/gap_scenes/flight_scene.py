"""A body in flight, for the diagnosis: gravity is known, everything else may be missing."""

from __future__ import annotations

from functools import cache

import numpy as np

from models.estimation.gap_scenes.contact_free_scene import (
    Force,
    Numbers,
    SceneEffect,
    SmoothScene,
    brake_probe,
    compiled_here,
    marcher,
)
from models.physics.effect import Prior

STILL = 1e-3
"""m/s below which drag by the square of speed fades out."""


def effects(coordinates: int) -> tuple[SceneEffect, ...]:
    """The catalogue in so many coordinates, the last of which is height."""
    level = ("wind_x", "wind_y")[: coordinates - 1]
    wind = tuple(Prior(name, "m/s", 0.0, 1.0, False, (-20.0, 20.0)) for name in level)
    drags = (
        SceneEffect(
            "air_drag", (Prior("k", "1/m", 0.0, 0.1, False, (0.0, 5.0)),), (0.0,), ("flight",),
            "a = -k u u against the air; k = g / (terminal speed)^2", ("viscous_drag",),
        ),
        SceneEffect(
            "viscous_drag", (Prior("k", "1/s", 0.0, 0.3, False, (0.0, 20.0)),), (0.0,), ("flight",),
            "a = -k u against the air, Stokes 1851", ("air_drag",),
        ),
    )  # fmt: skip
    probe = brake_probe("m", "flight")
    if coordinates == 1:
        return (*drags, probe)
    magnus = SceneEffect(
        "magnus", (Prior("s", "1/s", 0.0, 0.3, False, (-20.0, 20.0)),), (0.0,), ("flight",),
        "a = s v turned by 90 degrees, up where it flies towards +x: lift by spin", ("wind",),
    )  # fmt: skip
    blown = SceneEffect(
        "wind", wind, (0.0,) * len(wind), ("flight",),
        "steady air, without which drag is measured; it pulls at 0.1 1/s of its speed where there is no other drag",
        ("magnus",),
    )  # fmt: skip
    return (*drags, magnus, blown, probe)


LEAST_DRAG = 0.1
"""1/s by which wind pulls at a body that has no drag."""
FAINT, BRISK = 0.02, 10.0
"""1/s of drag at a speed of so many m/s from which that is all of the wind."""


@cache
def force_of(coordinates: int, gravity: float) -> Force:
    """Acceleration by gravity (m/s2), drags, lift and wind, in the order of `effects`."""

    @compiled_here
    def force(place: Numbers, velocity: Numbers, p: Numbers, out: Numbers) -> None:
        last = coordinates - 1
        square = 0 * velocity[0] + STILL**2
        for k in range(coordinates):
            blown = p[3 + k] if k < last else 0.0 * p[0]
            square += (velocity[k] - blown) * (velocity[k] - blown)
        speed = np.sqrt(square)
        drag = p[0] * speed + p[1]
        usual = p[0] * BRISK + p[1]
        least = LEAST_DRAG * np.exp(-usual * usual / FAINT**2)
        for k in range(coordinates):
            blown = p[3 + k] if k < last else 0.0 * p[0]
            out[k] = -drag * (velocity[k] - blown) + least * blown
        out[last] -= gravity
        if coordinates > 1:
            out[0] -= p[2] * velocity[last]
            out[last] += p[2] * velocity[0]

    found: Force = force
    return found


def flight_scene(coordinates: int, gravity: float = 9.81, assumed: tuple[str, ...] = ()) -> SmoothScene:
    """The scene for a simulator that has gravity and the effects `assumed`."""
    march = marcher(force_of(coordinates, gravity), True)
    return SmoothScene(
        "flight", "m", "flight", effects(coordinates), assumed, march, ("lens_distortion", "perspective")
    )
