"""Simulate one rod that swings about a pivot. `worlds/filming.py` describes the command.

A uniform rod of 0.3 m. Possible effects: friction of the joint (`joint_friction`: viscous, 1/s, and dry, rad/s2), air
drag, and a tilted camera (`gravity_tilt`, rad). Effects that are in no library: a `spiral_spring` at the joint
(acceleration -k theta), a `magnet` below (an acceleration m sin(2 theta)), and `drag_power` (a drag -k w^power).
Known inputs: a `torque` over the moment of inertia (rad/s2), and the place of the pivot (`pivot_x` to the right,
`pivot_y` up, m), which moves a rod whose mass is in its middle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from filming import STILL, Effects, Floats, Throw, Waves, integrate_motion, run_script

GRAVITY, LENGTH = 9.81, 0.3
# Restoring acceleration of a uniform rod, 1/s2.
PULL = 1.5 * GRAVITY / LENGTH
# Speed below which dry friction is smoothed, rad/s, so that a swing stops without a jump.
TURNING = 1e-3
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "joint_friction": ("viscous", "dry"),
    "air_drag": ("k",),
    "gravity_tilt": ("angle",),
    "spiral_spring": ("k",),
    "magnet": ("m",),
    "drag_power": ("k", "power"),
}


def play(effects: Effects, throw: Throw, chance: np.random.Generator, t: Floats, waves: Waves = STILL) -> Floats:
    """Return angles (T, 1) rad of a rod that is released, or pushed, at angles of up to 2 rad from its rest."""
    joint, air = effects.get("joint_friction", {}), effects.get("air_drag", {}).get("k", 0.0)
    tilt = effects.get("gravity_tilt", {}).get("angle", 0.0)
    between = effects.get("drag_power", {"k": 0.0, "power": 1.0})
    spring, magnet = effects.get("spiral_spring", {}).get("k", 0.0), effects.get("magnet", {}).get("m", 0.0)

    def force(now: float, angle: Floats, w: Floats) -> Floats:
        dry = joint.get("dry", 0.0) * np.tanh(w / TURNING)
        rub = joint.get("viscous", 0.0) * w + dry + air * np.abs(w) * w
        rub = rub + between["k"] * np.abs(w) ** between["power"] * np.sign(w)
        # mass times the pivot's acceleration acts backwards on the middle; lever over moment of inertia is 1.5 / length
        right, up = (waves.evaluate(name, now, 2) for name in ("pivot_x", "pivot_y"))
        turned = waves.evaluate("torque", now) - 1.5 / LENGTH * (right * np.cos(angle) + up * np.sin(angle))
        return -PULL * np.sin(angle - tilt) - rub - spring * angle - magnet * np.sin(2 * angle) + turned

    angle, turning = chance.uniform(-2.0, 2.0, 1), chance.uniform(-3.0, 3.0, 1)
    return integrate_motion(force, np.full(1, throw["angle"]) if "angle" in throw else angle, turning, t)


if __name__ == "__main__":
    run_script("pendulum", ("theta1",), EFFECTS, play)
