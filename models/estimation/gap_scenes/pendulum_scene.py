"""A pendulum of one or two rigid rods, for the diagnosis: rods without friction, unless the simulator has more.

Angles are absolute, 0 hanging, counter-clockwise. Rods of any shape: of two, what enters is the second one's moment of
inertia about its joint, the coupling of both, and the pull of gravity on each, all over the first one's moment about
the pivot (with the joint's load). Only ratios can be told from motion.
"""

from __future__ import annotations

import numpy as np

from models.estimation.gap_scenes.contact_free_scene import Numbers, SceneEffect, SmoothScene, brake_probe, marcher
from models.numerics.jit import compiled
from models.physics.effect import Prior

TURNING = 0.004
"""rad/s at which dry friction fades out: a rod that sticks creeps a milliradian in a quarter of a second."""

_PULL = Prior("pull", "1/s2", 50.0, 1.0, True, (0.5, 5000.0))
_VISCOUS = Prior("viscous", "1/s", 0.0, 0.2, False, (0.0, 20.0))
_DRY = Prior("dry", "rad/s2", 0.0, 0.5, False, (0.0, 50.0))
_FRICTION = "Viscous c w and dry friction d sign(w) of each joint, over the moment of inertia"


def effects(angles: int) -> tuple[SceneEffect, ...]:
    """The catalogue for one or two angles."""
    if angles == 1:
        return (
            SceneEffect("rods", (_PULL,), (50.0,), ("swing",), "w'' = -pull sin(theta)"),
            SceneEffect("joint_friction", (_VISCOUS, _DRY), (0.0, 0.0), ("swing",), _FRICTION, ("air_drag",)),
            SceneEffect(
                "air_drag", (Prior("k", "1", 0.0, 0.05, False, (0.0, 5.0)),), (0.0,), ("swing",), "w' = -k w w",
                ("joint_friction",),
            ),
            SceneEffect(
                "gravity_tilt", (Prior("angle", "rad", 0.0, 0.02, False, (-0.5, 0.5)),), (0.0,), ("swing",),
                "the vertical of the picture is not that of gravity",
            ),
            brake_probe("rad", "swing"),
        )  # fmt: skip
    rods = SceneEffect(
        "rods",
        (
            _PULL,
            Prior("second", "1", 0.3, 1.0, True, (0.01, 10.0)),
            Prior("coupling", "1", 0.3, 1.0, True, (0.01, 10.0)),
            Prior("second_pull", "1/s2", 20.0, 1.0, True, (0.1, 2000.0)),
        ),
        (50.0, 0.3, 0.3, 20.0), ("swing",), "Lagrange's equations of two rods",
    )  # fmt: skip
    friction = SceneEffect(
        "joint_friction",
        (_VISCOUS, _DRY, Prior("viscous_2", "1/s", 0.0, 0.1, False, (0.0, 20.0)),
         Prior("dry_2", "rad/s2", 0.0, 0.2, False, (0.0, 50.0))),
        (0.0, 0.0, 0.0, 0.0), ("swing",), _FRICTION, ("air_drag",),
    )  # fmt: skip
    tilt = SceneEffect(
        "gravity_tilt", (Prior("angle", "rad", 0.0, 0.02, False, (-0.5, 0.5)),), (0.0,), ("swing",),
        "the vertical of the picture is not that of gravity",
    )  # fmt: skip
    return (rods, friction, tilt, brake_probe("rad", "swing"))


@compiled
def one_rod(place: Numbers, velocity: Numbers, p: Numbers, out: Numbers) -> None:
    """Angular acceleration, parameters in the order of `effects(1)`."""
    w = velocity[0]
    size = np.sqrt(w * w + TURNING**2)
    out[0] = -p[0] * np.sin(place[0] - p[4]) - p[1] * w - p[2] * w / size - p[3] * size * w


@compiled
def two_rods(place: Numbers, velocity: Numbers, p: Numbers, out: Numbers) -> None:
    """Angular accelerations, parameters in the order of `effects(2)`."""
    between = place[0] - place[1]
    cosine, sine = np.cos(between), np.sin(between)
    w1, w2 = velocity[0], velocity[1]
    w = w2 - w1
    at_joint = p[6] * w + p[7] * w / np.sqrt(w * w + TURNING**2)
    at_pivot = p[4] * w1 + p[5] * w1 / np.sqrt(w1 * w1 + TURNING**2)
    first = -p[2] * sine * w2 * w2 - p[0] * np.sin(place[0] - p[8]) - at_pivot + at_joint
    second = p[2] * sine * w1 * w1 - p[3] * np.sin(place[1] - p[8]) - at_joint
    whole = p[1] - p[2] * p[2] * cosine * cosine
    out[0] = (p[1] * first - p[2] * cosine * second) / whole
    out[1] = (second - p[2] * cosine * first) / whole


def pendulum_scene(angles: int, assumed: tuple[str, ...] = ()) -> SmoothScene:
    """The scene for a simulator of rods that has the effects `assumed` as well."""
    march = marcher(one_rod if angles == 1 else two_rods, True)
    known = ("rods", *(name for name in assumed if name != "rods"))
    return SmoothScene("pendulum", "rad", "swing", effects(angles), known, march, ("spring_nonlinearity", "rod_mass"))
