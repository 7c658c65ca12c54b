"""A body in flight, for the diagnosis: gravity is known, every other effect may be missing.

The known input of a flight in space is the axis of its spin, a unit vector; without it, a body spins about -y.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from models.core.constants import GRAVITY
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene, build_brake_probe
from models.estimation.gap_scenes.motion_integrator import AccelerationFunction, RealOrComplexArray, build_integrator
from models.numerics.jit import compile_kernel
from models.physics.effect import Effect, Prior

# m/s below which drag by the square of the speed vanishes.
MIN_DRAG_SPEED = 1e-3


def flight_effects(coordinates: int) -> tuple[Effect, ...]:
    """Build the catalogue of effects of a flight.

    Args:
        coordinates: Number of coordinates, the last of which is height.

    Returns:
        Drags, and with more than one coordinate lift and wind; the brake probe comes last.
    """
    level = ("wind_x", "wind_y")[: coordinates - 1]
    wind = tuple(Prior(name, "m/s", 0.0, 1.0, False, (-20.0, 20.0)) for name in level)
    drags = (
        Effect(
            "air_drag", (Prior("k", "1/m", 0.0, 0.1, False, (0.0, 5.0)),), (0.0,), ("flight",),
            "a = -k u u against the air; k = g / (terminal speed)^2", ("viscous_drag",),
        ),
        Effect(
            "viscous_drag", (Prior("k", "1/s", 0.0, 0.3, False, (0.0, 20.0)),), (0.0,), ("flight",),
            "a = -k u against the air, Stokes 1851", ("air_drag",),
        ),
    )  # fmt: skip
    probe = build_brake_probe("m", "flight")
    if coordinates == 1:
        return (*drags, probe)
    magnus = Effect(
        "magnus", (Prior("s", "1/s", 0.0, 0.3, False, (-20.0, 20.0)),), (0.0,), ("flight",),
        "a = s n x v with the spin axis n; without it, v rotated by 90 degrees, upwards for motion towards +x: lift",
        ("wind",),
    )  # fmt: skip
    blown = Effect(
        "wind", wind, (0.0,) * len(wind), ("flight",),
        "steady air, relative to which drag acts; it accelerates by 0.1 1/s of its speed where there is no other drag",
        ("magnus",),
    )  # fmt: skip
    return (*drags, magnus, blown, probe)


# 1/s of drag by which wind accelerates a body that has no other drag.
MIN_WIND_DRAG = 0.1
# 1/s of drag at this speed (m/s), from which `MIN_WIND_DRAG` no longer acts, see `NEGLIGIBLE_DRAG`.
NEGLIGIBLE_DRAG, DRAG_REFERENCE_SPEED = 0.02, 10.0


@cache
def build_flight_acceleration(coordinates: int, gravity: float, has_spin_axis: bool = False) -> AccelerationFunction:
    """Build the acceleration by gravity (m/s^2), drags, lift and wind.

    Its parameters are in the order of `flight_effects`; its inputs are the spin axis, where there is one.
    """

    @compile_kernel
    def force(
        place: RealOrComplexArray,
        velocity: RealOrComplexArray,
        p: RealOrComplexArray,
        given: RealOrComplexArray,
        out: RealOrComplexArray,
    ) -> None:
        last = coordinates - 1
        square = 0 * velocity[0] + MIN_DRAG_SPEED**2
        for k in range(coordinates):
            blown = p[3 + k] if k < last else 0.0 * p[0]
            square += (velocity[k] - blown) * (velocity[k] - blown)
        speed = np.sqrt(square)
        drag = p[0] * speed + p[1]
        usual = p[0] * DRAG_REFERENCE_SPEED + p[1]
        least = MIN_WIND_DRAG * np.exp(-usual * usual / NEGLIGIBLE_DRAG**2)
        for k in range(coordinates):
            blown = p[3 + k] if k < last else 0.0 * p[0]
            out[k] = -drag * (velocity[k] - blown) + least * blown
        out[last] -= gravity
        if has_spin_axis:
            out[0] += p[2] * (given[1] * velocity[2] - given[2] * velocity[1])
            out[1] += p[2] * (given[2] * velocity[0] - given[0] * velocity[2])
            out[2] += p[2] * (given[0] * velocity[1] - given[1] * velocity[0])
        elif coordinates > 1:
            out[0] -= p[2] * velocity[last]
            out[last] += p[2] * velocity[0]

    acceleration: AccelerationFunction = force
    return acceleration


def build_flight_scene(
    coordinates: int, gravity: float = GRAVITY, simulator_effects: tuple[str, ...] = (), has_spin_axis: bool = False
) -> ContactFreeScene:
    """Build the scene of a simulator that has gravity and further effects.

    Args:
        coordinates: Number of coordinates, the last of which is height.
        gravity: m/s^2.
        simulator_effects: Names of the effects that the simulator has.
        has_spin_axis: Whether recordings state the axis of the spin; only with three coordinates.

    Returns:
        The scene.
    """
    march = build_integrator(build_flight_acceleration(coordinates, gravity, has_spin_axis))
    return ContactFreeScene(
        "flight",
        "flight",
        flight_effects(coordinates),
        simulator_effects,
        march,
        ("lens_distortion", "perspective"),
        input_count=3 if has_spin_axis else 0,
        is_smooth=True,
    )
