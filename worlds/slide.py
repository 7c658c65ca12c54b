"""Simulate bodies that slide on a plane. `worlds/filming.py` describes the command.

Coulomb friction stops a body for good; drag depends on the speed and its square; the plane may be tilted. Effects that
are in no library: a `sticky_patch` (a disc of radius 0.3 m at (x, y) m with additional friction mu), `curl` (a moving
body turns: acceleration c v to its left), and `drag_power` (a drag -k v^power).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from filming import Effects, Floats, Throw, integrate_motion, run_script

GRAVITY = 9.81
STOP_SPEED = 1e-4
"""Speed at which a body stops, m/s."""
PATCH_RADIUS = 0.3
"""Radius of a sticky patch, m."""
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "sliding_friction": ("mu",),
    "viscous_drag": ("k",),
    "air_drag": ("k",),
    "slope": ("slope_x", "slope_y"),
    "sticky_patch": ("mu", "x", "y"),
    "curl": ("c",),
    "drag_power": ("k", "power"),
}


def play(effects: Effects, throw: Throw, chance: np.random.Generator, t: Floats) -> Floats:
    """Return positions (T, 2) m of a body that is pushed off near the origin in any direction."""
    place = chance.uniform(-0.3, 0.3, 2)
    drawn = {"speed": chance.uniform(0.5, 2.0), "angle": chance.uniform(0, 2 * np.pi)}
    speed, angle = throw.get("speed", drawn["speed"]), throw.get("angle", drawn["angle"])
    mu, patch = effects.get("sliding_friction", {}).get("mu", 0.0), effects.get("sticky_patch", {})
    viscous, air = (effects.get(name, {}).get("k", 0.0) for name in ("viscous_drag", "air_drag"))
    slope, curl = effects.get("slope", {}), effects.get("curl", {}).get("c", 0.0)
    between = effects.get("drag_power", {})
    fall = GRAVITY * 1e-3 * np.array([slope.get("slope_x", 0.0), slope.get("slope_y", 0.0)])

    def force(_: float, where: Floats, v: Floats) -> Floats:
        size = float(np.hypot(*v))
        sticky = bool(patch) and np.hypot(where[0] - patch["x"], where[1] - patch["y"]) < PATCH_RADIUS
        friction = (mu + patch["mu"] if sticky else mu) * GRAVITY
        pull: Floats = -(friction / max(size, 1e-12) + viscous + air * size) * v + fall
        if between:
            pull = pull - between["k"] * size ** (between["power"] - 1) * v
        return pull + curl * np.array([-v[1], v[0]])

    def remaining_speed(_: float, state: Floats) -> float:
        return float(np.hypot(state[2], state[3])) - STOP_SPEED

    braked = bool(mu or patch)
    return integrate_motion(
        force, place, speed * np.array([np.cos(angle), np.sin(angle)]), t, remaining_speed if braked else None
    )


if __name__ == "__main__":
    run_script("slide", ("x", "y"), EFFECTS, play)
