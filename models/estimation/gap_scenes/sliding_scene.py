"""A body that slides on a plane, for the diagnosis: no force acts on it unless the simulator has it.

Walls may reflect it. A body without spin loses part of its normal speed there, and part of its tangential speed by
Coulomb friction during the contact. Known inputs are two accelerations, along x and y.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from models.core.constants import GRAVITY
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene, build_brake_probe
from models.estimation.gap_scenes.motion_integrator import AccelerationFunction, build_integrator
from models.numerics.jit import compile_kernel
from models.physics.effect import Effect, Prior

# m/s at which friction fades out.
FRICTION_FADE_SPEED = 0.01
# Slope over mu up to which a stopped body sticks.
_STICK_SHARE = 0.98

# Effects between the walls.
SLIDING_EFFECTS = (
    Effect(
        "sliding_friction", (Prior("mu", "1", 0.2, 0.2, False, (0.0, 2.0)),), (0.0,), ("slide",),
        "Coulomb 1785: a = -mu g, independent of speed", ("viscous_drag",),
    ),
    Effect(
        "viscous_drag", (Prior("k", "1/s", 0.0, 1.0, False, (0.0, 50.0)),), (0.0,), ("slide",),
        "a = -k v: a lubricated contact", ("sliding_friction", "air_drag"),
    ),
    Effect(
        "air_drag", (Prior("k", "1/m", 0.0, 0.3, False, (0.0, 20.0)),), (0.0,), ("slide",),
        "a = -k v v", ("viscous_drag",),
    ),
    Effect(
        "slope", (Prior("slope_x", "mm/m", 0.0, 10.0, False, (-200.0, 200.0)),
                  Prior("slope_y", "mm/m", 0.0, 10.0, False, (-200.0, 200.0))), (0.0, 0.0), ("slide",),
        "g times the slope, in the downhill direction", ("sliding_friction",),
    ),
)  # fmt: skip
# Offered where a body swings to and fro between no walls: elsewhere it would imitate any force that varies.
SPRING = Effect(
    "spring", (Prior("k", "1/s2", 0.0, 30.0, False, (0.0, 1e4)),
               Prior("pull_x", "m/s2", 0.0, 3.0, False, (-1e3, 1e3)),
               Prior("pull_y", "m/s2", 0.0, 3.0, False, (-1e3, 1e3))), (0.0, 0.0, 0.0), ("slide",),
    "Hooke 1678: a = pull - k x, at rest at pull / k; k is the stiffness over the mass", ("slope",),
)  # fmt: skip
# Effects of walls; their parameters follow those of `SLIDING_EFFECTS`.
WALL_EFFECTS = (
    Effect(
        "wall_restitution", (Prior("e", "1", 0.7, 0.2, False, (0.05, 1.0)),), (1.0,), ("wall_contact",),
        "share of the normal speed that is returned, Newton 1687", ("wall_friction", "sliding_friction"),
    ),
    Effect(
        "wall_friction", (Prior("mu", "1", 0.2, 0.2, False, (0.0, 2.0)),), (0.0,), ("wall_contact",),
        "the tangential speed drops by mu (1 + e) times the normal speed, at most to 0: Coulomb friction, no spin",
        ("wall_restitution", "sliding_friction"),
    ),
)  # fmt: skip
# Indices of the restitution and the friction of walls among all parameters.
_WALL_PARAMETERS = (5, 6)
# Standard deviations by which a body has to move back for a turn, or move further midway.
_TURN_SIGMAS = 10.0
# Turns in one shot from which a body swings: a slope turns it once.
_SWING_TURNS = 2
# Standard deviations within which an observed position may be at a wall.
_NEAR_SIGMAS = 3.0
# Known accelerations along x and y, m/s^2.
INPUT_COUNT = 2


@cache
def _build_acceleration(has_spring: bool) -> AccelerationFunction:
    """Build the acceleration by effects and inputs, with parameters in the order of `SLIDING_EFFECTS`.

    Those of a spring follow, if there is one. Friction fades out at the velocity where it balances slope, spring and
    inputs, not at zero velocity, so that a stopped body does not creep.
    """

    @compile_kernel
    def sliding_acceleration(place, velocity, p, given, out):  # type: ignore[no-untyped-def]
        square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
        speed = np.sqrt(square + FRICTION_FADE_SPEED**2)
        brake = p[1] + p[2] * speed
        fall_x, fall_y = GRAVITY * 1e-3 * p[3] + given[0], GRAVITY * 1e-3 * p[4] + given[1]
        if has_spring:
            fall_x, fall_y = fall_x + p[6] - p[5] * place[0], fall_y + p[7] - p[5] * place[1]
        friction = p[0] * GRAVITY
        rubbed_x, rubbed_y = velocity[0], velocity[1]
        holds = friction * friction - fall_x * fall_x - fall_y * fall_y
        if holds.real > (1 - _STICK_SHARE**2) * (friction * friction).real:
            lean = FRICTION_FADE_SPEED / np.sqrt(holds) * np.exp(-square / FRICTION_FADE_SPEED**2)
            rubbed_x, rubbed_y = rubbed_x + lean * fall_x, rubbed_y + lean * fall_y
            speed = np.sqrt(rubbed_x * rubbed_x + rubbed_y * rubbed_y + FRICTION_FADE_SPEED**2)
        out[0] = fall_x - brake * velocity[0] - friction * rubbed_x / speed
        out[1] = fall_y - brake * velocity[1] - friction * rubbed_y / speed

    acceleration: AccelerationFunction = sliding_acceleration
    return acceleration


def build_sliding_scene(
    simulator_effects: tuple[str, ...] = (),
    walls: tuple[tuple[float, float], ...] = (),
    recordings: tuple[Recording, ...] | None = None,
) -> ContactFreeScene:
    """Build the scene of a simulator with some of the effects.

    Args:
        simulator_effects: Names of the effects that the simulator has.
        walls: Lower and upper limit (m) of the centre of a body along x and along y; empty where there are no walls.
        recordings: Recordings to be diagnosed. Where no body meets a wall, effects of walls are only offered if the
            simulator has them; where none swings, no spring. None: bodies meet walls, and swing without them.

    Returns:
        The scene.
    """
    untested: tuple[str, ...] = ("lens_distortion", "perspective")
    offered: tuple[Effect, ...] = WALL_EFFECTS if walls else ()
    if walls and recordings is not None and not any(meets_wall(one, np.array(walls)) for one in recordings):
        untested += tuple(f"{one.name}: no body meets a wall" for one in WALL_EFFECTS)
        offered = WALL_EFFECTS if {one.name for one in WALL_EFFECTS} & set(simulator_effects) else ()
    elif not walls:
        untested += tuple(f"{one.name}: no walls are stated" for one in WALL_EFFECTS)
    has_spring = not walls and (recordings is None or any(map(_swings, recordings)) or SPRING.name in simulator_effects)
    if has_spring:
        offered = (SPRING,)
    else:
        untested += (f"{SPRING.name}: no body swings between no walls",)
    return ContactFreeScene(
        "slide",
        "slide",
        (*SLIDING_EFFECTS, *offered, build_brake_probe("m", "slide")),
        simulator_effects,
        build_integrator(_build_acceleration(has_spring), bool(walls), _WALL_PARAMETERS if walls and offered else None),
        untested,
        input_count=INPUT_COUNT,
        walls=walls,
    )


def meets_wall(recording: Recording, walls: FloatArray) -> bool:
    """Return whether a body comes so near to a wall that it may meet it before the next frame.

    Args:
        recording: Recording, or a part of it.
        walls: (2, 2) m, lower and upper limit of the centre of a body along x and along y.
    """
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.is_observed[:, body])
        places = recording.positions[rows, body]
        reach = np.abs(np.diff(places, axis=0, append=places[-1:])) + _NEAR_SIGMAS * recording.sigma[rows, body, None]
        if ((places - walls[:, 0] < reach) | (walls[:, 1] - places < reach)).any():
            return True
    return False


def _swings(recording: Recording) -> bool:
    """Return whether a body swings along a coordinate: it turns back at least twice, or is fastest midway.

    Without a spring, a body between no walls is fastest where its path begins or ends, and turns once at most. One that
    is driven by known inputs is left out: they may swing it.
    """
    if recording.inputs is not None:
        return False
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.is_observed[:, body])
        back = _TURN_SIGMAS * float(np.median(recording.sigma[rows, body])) if len(rows) else 0.0
        for places in recording.positions[rows, body].T:
            if _count_turns(places, back) >= _SWING_TURNS or _is_fastest_midway(recording.t[rows], places, back):
                return True
    return False


def _is_fastest_midway(t: FloatArray, places: FloatArray, back: float) -> bool:
    """Return whether a coordinate (T,) goes further in the middle third of the time than in both others by `back`."""
    if len(t) < 4:
        return False
    first, middle, last = np.abs(np.diff(np.interp(np.linspace(t[0], t[-1], 4), t, places))).tolist()
    return bool(middle - max(first, last) > back)


def _count_turns(places: FloatArray, back: float) -> int:
    """Count how often a coordinate (T,) turns and then moves back by more than `back`."""
    turns, direction, extreme = 0, 0, float(places[0]) if len(places) else 0.0
    for place in places.tolist():
        if direction == 0 and abs(place - extreme) > back:
            direction, extreme = (1 if place > extreme else -1), place
        elif direction and (place - extreme) * direction > 0:
            extreme = place
        elif direction and (extreme - place) * direction > back:
            turns, direction, extreme = turns + 1, -direction, place
    return turns
