"""A world of one rod that swings about a pivot. `worlds/filming.py` says how it is called.

A uniform rod of 0.3 m. Its joint may rub (`joint_friction`: viscous, 1/s, and dry, rad/s2), the air may brake it, the
camera may stand crooked (`gravity_tilt`, rad). What no library of effects holds: a `spiral_spring` at the joint
(acceleration -k theta), a `magnet` below (a pull m sin(2 theta)), and `drag_power` (a drag -k w^power).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from filming import Effects, Floats, Throw, flown, run

GRAVITY, LENGTH = 9.81, 0.3
PULL = 1.5 * GRAVITY / LENGTH
"""1/s2, of a uniform rod."""
TURNING = 1e-3
"""rad/s below which dry friction holds on gently: it stops a swing without a jump."""
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "joint_friction": ("viscous", "dry"),
    "air_drag": ("k",),
    "gravity_tilt": ("angle",),
    "spiral_spring": ("k",),
    "magnet": ("m",),
    "drag_power": ("k", "power"),
}


def play(effects: Effects, throw: Throw, chance: np.random.Generator, t: Floats) -> Floats:
    """Angles (T, 1) rad of a rod that is let go, or pushed, from anywhere below the horizontal."""
    joint, air = effects.get("joint_friction", {}), effects.get("air_drag", {}).get("k", 0.0)
    tilt = effects.get("gravity_tilt", {}).get("angle", 0.0)
    between = effects.get("drag_power", {"k": 0.0, "power": 1.0})
    spring, magnet = effects.get("spiral_spring", {}).get("k", 0.0), effects.get("magnet", {}).get("m", 0.0)

    def force(_: float, angle: Floats, w: Floats) -> Floats:
        dry = joint.get("dry", 0.0) * np.tanh(w / TURNING)
        rub = joint.get("viscous", 0.0) * w + dry + air * np.abs(w) * w
        rub = rub + between["k"] * np.abs(w) ** between["power"] * np.sign(w)
        return -PULL * np.sin(angle - tilt) - rub - spring * angle - magnet * np.sin(2 * angle)

    angle, turning = chance.uniform(-2.0, 2.0, 1), chance.uniform(-3.0, 3.0, 1)
    return flown(force, np.full(1, throw["angle"]) if "angle" in throw else angle, turning, t)


if __name__ == "__main__":
    run("pendulum", ("theta1",), EFFECTS, play)
