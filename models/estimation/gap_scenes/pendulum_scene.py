"""A pendulum of one or two rigid rods, for the diagnosis: rods without friction, unless the simulator has more.

Angles are absolute, 0 hanging, counter-clockwise. The rods may have any shape: of two, the parameters are the second
one's moment of inertia about its joint, the coupling of both, and the torque of gravity on each, all divided by the
first one's moment about the pivot (with the joint's load). Only such ratios can be identified from motion.

Known inputs are a torque on the first rod at the pivot, divided by the same moment (rad/s^2), and the acceleration of
the pivot to the right and upwards (m/s^2). A pivot that accelerates is like another gravity: it acts on a rod by the
share of its pull in `GRAVITY`.
"""

from __future__ import annotations

import numpy as np

from models.core.constants import GRAVITY
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene, build_brake_probe
from models.estimation.gap_scenes.motion_integrator import RealOrComplexArray, build_integrator
from models.numerics.jit import compile_kernel
from models.physics.effect import Effect, Prior

# Torque at the pivot over the first moment of inertia, acceleration of the pivot to the right and upwards.
INPUT_COUNT = 3
# rad/s at which dry friction fades out: a rod that sticks creeps a milliradian in a quarter of a second.
DRY_FRICTION_FADE_SPEED = 0.004

_PULL = Prior("pull", "1/s2", 50.0, 1.0, True, (0.5, 5000.0))
_VISCOUS = Prior("viscous", "1/s", 0.0, 0.2, False, (0.0, 20.0))
_DRY = Prior("dry", "rad/s2", 0.0, 0.5, False, (0.0, 50.0))
_FRICTION = "Viscous c w and dry friction d sign(w) of each joint, over the moment of inertia"


def pendulum_effects(angles: int) -> tuple[Effect, ...]:
    """Build the catalogue of effects of a pendulum with one or two angles.

    Args:
        angles: Number of angles.

    Returns:
        Rods, friction, tilt, with one angle air drag; the brake probe comes last.
    """
    tilt = Effect(
        "gravity_tilt", (Prior("angle", "rad", 0.0, 0.02, False, (-0.5, 0.5)),), (0.0,), ("swing",),
        "the vertical of the image is not that of gravity",
    )  # fmt: skip
    if angles == 1:
        return (
            Effect("rods", (_PULL,), (50.0,), ("swing",), "w'' = -pull sin(theta)"),
            Effect("joint_friction", (_VISCOUS, _DRY), (0.0, 0.0), ("swing",), _FRICTION, ("air_drag",)),
            Effect(
                "air_drag", (Prior("k", "1", 0.0, 0.05, False, (0.0, 5.0)),), (0.0,), ("swing",), "w' = -k w w",
                ("joint_friction",),
            ),
            tilt,
            build_brake_probe("rad", "swing"),
        )  # fmt: skip
    rods = Effect(
        "rods",
        (
            _PULL,
            Prior("second", "1", 0.3, 1.0, True, (0.01, 10.0)),
            Prior("coupling", "1", 0.3, 1.0, True, (0.01, 10.0)),
            Prior("second_pull", "1/s2", 20.0, 1.0, True, (0.1, 2000.0)),
        ),
        (50.0, 0.3, 0.3, 20.0), ("swing",), "Lagrange's equations of two rods",
    )  # fmt: skip
    friction = Effect(
        "joint_friction",
        (_VISCOUS, _DRY, Prior("viscous_2", "1/s", 0.0, 0.1, False, (0.0, 20.0)),
         Prior("dry_2", "rad/s2", 0.0, 0.2, False, (0.0, 50.0))),
        (0.0, 0.0, 0.0, 0.0), ("swing",), _FRICTION, ("air_drag",),
    )  # fmt: skip
    return (rods, friction, tilt, build_brake_probe("rad", "swing"))


@compile_kernel
def one_rod_acceleration(
    place: RealOrComplexArray,
    velocity: RealOrComplexArray,
    p: RealOrComplexArray,
    given: RealOrComplexArray,
    out: RealOrComplexArray,
) -> None:
    """Fill the angular acceleration, with parameters in the order of `pendulum_effects(1)`."""
    w = velocity[0]
    size = np.sqrt(w * w + DRY_FRICTION_FADE_SPEED**2)
    pulled = np.sin(place[0] - p[4]) + (given[1] * np.cos(place[0]) + given[2] * np.sin(place[0])) / GRAVITY
    out[0] = given[0] - p[0] * pulled - p[1] * w - p[2] * w / size - p[3] * size * w


@compile_kernel
def two_rod_acceleration(
    place: RealOrComplexArray,
    velocity: RealOrComplexArray,
    p: RealOrComplexArray,
    given: RealOrComplexArray,
    out: RealOrComplexArray,
) -> None:
    """Fill the angular accelerations, with parameters in the order of `pendulum_effects(2)`."""
    between = place[0] - place[1]
    cosine, sine = np.cos(between), np.sin(between)
    w1, w2 = velocity[0], velocity[1]
    w = w2 - w1
    at_joint = p[6] * w + p[7] * w / np.sqrt(w * w + DRY_FRICTION_FADE_SPEED**2)
    at_pivot = p[4] * w1 + p[5] * w1 / np.sqrt(w1 * w1 + DRY_FRICTION_FADE_SPEED**2)
    pulled = np.sin(place[0] - p[8]) + (given[1] * np.cos(place[0]) + given[2] * np.sin(place[0])) / GRAVITY
    second_pulled = np.sin(place[1] - p[8]) + (given[1] * np.cos(place[1]) + given[2] * np.sin(place[1])) / GRAVITY
    first = given[0] - p[2] * sine * w2 * w2 - p[0] * pulled - at_pivot + at_joint
    second = p[2] * sine * w1 * w1 - p[3] * second_pulled - at_joint
    whole = p[1] - p[2] * p[2] * cosine * cosine
    out[0] = (p[1] * first - p[2] * cosine * second) / whole
    out[1] = (second - p[2] * cosine * first) / whole


def build_pendulum_scene(angles: int, simulator_effects: tuple[str, ...] = ()) -> ContactFreeScene:
    """Build the scene of a simulator of rods.

    Args:
        angles: Number of angles, 1 or 2.
        simulator_effects: Names of further effects that the simulator has.

    Returns:
        The scene.
    """
    march = build_integrator(one_rod_acceleration if angles == 1 else two_rod_acceleration)
    present = ("rods", *(name for name in simulator_effects if name != "rods"))
    return ContactFreeScene(
        "pendulum",
        "swing",
        pendulum_effects(angles),
        present,
        march,
        ("spring_nonlinearity", "rod_mass"),
        input_count=INPUT_COUNT,
    )
