"""Simulate bodies that slide on a plane. `worlds/filming.py` describes the command.

Coulomb friction stops a body for good; drag depends on the speed and its square; the plane may be tilted. Effects that
are in no library: a `sticky_patch` (a disc of radius 0.3 m at (x, y) m with additional friction mu), `curl` (a moving
body turns: acceleration c v to its left), and `drag_power` (a drag -k v^power).

With `walls` in `facts` ([x0, y0, x1, y1] m, and the `radius` of the body) a rectangle reflects the body: it keeps the
share `wall_restitution` e of its normal speed, and the impulse of friction along the wall is mu of the normal one
(`wall_friction`), at most so much that the body slides no more. In no library: `fading_restitution`, e = e0 - slope v.

Known inputs: a force over mass (`force_x`, `force_y`, m/s2), and the place of the platform on which the body slides
(`platform_x`, `platform_y`, m). The motion is integrated in the room, and written relative to the platform.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from filming import STILL, TOLERANCE, Effects, Floats, Force, Throw, Waves, integrate_motion, run_script
from scipy.integrate import solve_ivp

GRAVITY = 9.81
# Speed at which a body stops, m/s.
STOP_SPEED = 1e-4
# Speed below which friction of a driven body is smoothed, m/s.
SOFT_SPEED = 1e-3
# Radius of a sticky patch, m.
PATCH_RADIUS = 0.3
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "sliding_friction": ("mu",),
    "viscous_drag": ("k",),
    "air_drag": ("k",),
    "slope": ("slope_x", "slope_y"),
    "sticky_patch": ("mu", "x", "y"),
    "curl": ("c",),
    "drag_power": ("k", "power"),
    "wall_restitution": ("e",),
    "wall_friction": ("mu",),
    "fading_restitution": ("e0", "slope"),
}


def bounce(effects: Effects, velocity: Floats, normal: Floats) -> Floats:
    """Return the velocity (2,) after a contact with a wall whose unit normal (2,) points at the body."""
    closing = -float(velocity @ normal)
    fading = effects.get("fading_restitution", {})
    e = fading["e0"] - fading["slope"] * closing if fading else effects.get("wall_restitution", {}).get("e", 1.0)
    along = velocity + closing * normal
    impulse = (1 + e) * closing
    sliding = float(np.hypot(*along))
    rubbed = min(effects.get("wall_friction", {}).get("mu", 0.0) * impulse, sliding)
    return along * (1 - rubbed / sliding if sliding else 1.0) + e * closing * normal


def remaining_speed(_: float, state: Floats) -> float:
    """Return how much faster a body is than one that stops, m/s."""
    return float(np.hypot(state[2], state[3])) - STOP_SPEED


def integrate_between_walls(
    effects: Effects, force: Force, place: Floats, velocity: Floats, t: Floats, sides: Floats, braked: bool
) -> Floats:
    """Return positions (T, 2) of a body whose centre stays within `sides` (2, 2), lower and upper ones."""
    state, begin, places = np.concatenate([place, velocity]), t[0], np.empty((len(t), 2))

    def rate(now: float, state: Floats) -> Floats:
        return np.concatenate([state[2:], force(now, state[:2], state[2:])])

    def stop(now: float, state: Floats) -> float:
        return remaining_speed(now, state) if braked else 1.0

    def build_event(axis: int, side: int):  # type: ignore[no-untyped-def]
        def gap(_: float, state: Floats) -> float:
            return float((1 - 2 * side) * (state[axis] - sides[axis, side]))

        gap.terminal, gap.direction = True, -1  # type: ignore[attr-defined]
        return gap

    stop.terminal = True  # type: ignore[attr-defined]
    events = [build_event(axis, side) for axis in range(2) for side in range(2)]
    while True:
        solved = solve_ivp(rate, (begin, t[-1]), state, "DOP853", events=[stop, *events], rtol=TOLERANCE, atol=1e-12,
                           max_step=0.02, dense_output=True)  # fmt: skip
        here = (t >= begin) & (t <= solved.t[-1])
        if here.any():  # no sample lies between two contacts in a corner
            places[here] = solved.sol(t[here])[:2].T
        state, begin = solved.y[:, -1], solved.t[-1]
        if solved.status == 0:
            return places
        if len(solved.t_events[0]):
            places[t > begin] = state[:2]
            return places
        number = next(k for k in range(4) if len(solved.t_events[1 + k]))
        axis, side = divmod(number, 2)
        normal = np.eye(2)[axis] * (1 - 2 * side)
        state[2:] = bounce(effects, state[2:], normal)
        state[axis] = sides[axis, side]


def play(
    effects: Effects,
    throw: Throw,
    chance: np.random.Generator,
    t: Floats,
    walls: tuple[float, ...] = (),
    radius: float = 0.0,
    waves: Waves = STILL,
) -> Floats:
    """Return positions (T, 2) m of a body that is pushed off near the origin in any direction."""
    place = chance.uniform(-0.3, 0.3, 2)
    drawn = {"speed": chance.uniform(0.5, 2.0), "angle": chance.uniform(0, 2 * np.pi)}
    speed, angle = throw.get("speed", drawn["speed"]), throw.get("angle", drawn["angle"])
    mu, patch = effects.get("sliding_friction", {}).get("mu", 0.0), effects.get("sticky_patch", {})
    viscous, air = (effects.get(name, {}).get("k", 0.0) for name in ("viscous_drag", "air_drag"))
    slope, curl = effects.get("slope", {}), effects.get("curl", {}).get("c", 0.0)
    between = effects.get("drag_power", {})
    fall = GRAVITY * 1e-3 * np.array([slope.get("slope_x", 0.0), slope.get("slope_y", 0.0)])

    def evaluate(name: str, now: float | Floats, derivative: int = 0) -> Floats:
        return np.array([waves.evaluate(f"{name}_{axis}", now, derivative) for axis in "xy"])

    def force(now: float, where: Floats, v: Floats) -> Floats:
        given = evaluate("force", now)
        where, v = where - evaluate("platform", now), v - evaluate("platform", now, 1)
        size = float(np.hypot(*v))
        sticky = bool(patch) and np.hypot(where[0] - patch["x"], where[1] - patch["y"]) < PATCH_RADIUS
        friction = (mu + patch["mu"] if sticky else mu) * GRAVITY
        # a driven body may stick and slip again, where a jump of friction at rest would take endless steps
        friction *= np.tanh(size / SOFT_SPEED) if waves.drive else 1.0
        pull: Floats = -(friction / max(size, 1e-12) + viscous + air * size) * v + fall
        if between:
            pull = pull - between["k"] * size ** (between["power"] - 1) * v
        return pull + curl * np.array([-v[1], v[0]]) + given

    braked = bool(mu or patch)
    velocity = speed * np.array([np.cos(angle), np.sin(angle)])
    if walls:
        x0, y0, x1, y1 = walls
        sides = np.array([[x0 + radius, x1 - radius], [y0 + radius, y1 - radius]])
        return integrate_between_walls(effects, force, place, velocity, t, sides, braked)
    # a driven body that stops is set in motion again
    carried = np.stack([evaluate("platform", t[0], k) for k in (0, 1)])
    stop = remaining_speed if braked and not waves.drive else None
    return integrate_motion(force, place + carried[0], velocity + carried[1], t, stop) - evaluate("platform", t).T


if __name__ == "__main__":
    run_script("slide", ("x", "y"), EFFECTS, play)
