"""Simulate one rod that swings about a pivot with MuJoCo. `worlds/filming.py` describes the command.

The rod and its effects are those of `pendulum.py`: a hinge with damping and dry friction loss as MuJoCo has them (dry
friction is a soft constraint there, not a sign), air drag applied as a torque, and tilted gravity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco
import numpy as np
from filming import Effects, Floats, Throw, run_script

GRAVITY, LENGTH, MASS = 9.81, 0.3, 0.1
# kg m2, of a uniform rod about its end; friction and drag are given per inertia.
INERTIA = MASS * LENGTH**2 / 3
# Largest step, s.
STEP = 5e-4
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "joint_friction": ("viscous", "dry"),
    "air_drag": ("k",),
    "gravity_tilt": ("angle",),
}
ROD = """
<mujoco>
  <option integrator="RK4" timestep="{step!r}" gravity="{fall_x!r} 0 {fall_z!r}"/>
  <worldbody>
    <body>
      <joint type="hinge" axis="0 -1 0" damping="{damping!r}" frictionloss="{dry!r}" solreffriction="{soft!r} 1"/>
      <inertial pos="0 0 {middle!r}" mass="{mass!r}" diaginertia="{across!r} {across!r} {along!r}"/>
    </body>
  </worldbody>
</mujoco>
"""
# Time constant of dry friction, s.
SOFT = 2e-3


def build_rod(effects: Effects, step: float) -> mujoco.MjModel:
    """Build a rod that hangs along -z at angle 0; angles grow towards +x."""
    joint, tilt = effects.get("joint_friction", {}), effects.get("gravity_tilt", {}).get("angle", 0.0)
    return mujoco.MjModel.from_xml_string(
        ROD.format(
            step=step, fall_x=GRAVITY * math.sin(tilt), fall_z=-GRAVITY * math.cos(tilt), soft=SOFT,
            damping=INERTIA * joint.get("viscous", 0.0), dry=INERTIA * joint.get("dry", 0.0), middle=-LENGTH / 2,
            mass=MASS, across=MASS * LENGTH**2 / 12, along=1e-6,
        )
    )  # fmt: skip


def play(effects: Effects, throw: Throw, chance: np.random.Generator, t: Floats) -> Floats:
    """Return angles (T, 1) rad of a rod that is released, or pushed, at angles of up to 2 rad from its rest."""
    angle, turning = float(chance.uniform(-2.0, 2.0)), float(chance.uniform(-3.0, 3.0))
    interval = float(t[1] - t[0])
    steps = math.ceil(interval / STEP)
    model = build_rod(effects, interval / steps)
    state, air = mujoco.MjData(model), effects.get("air_drag", {}).get("k", 0.0)
    state.qpos[0], state.qvel[0] = throw.get("angle", angle), turning
    angles = [state.qpos[0]]
    for _ in t[1:]:
        for _ in range(steps):
            state.qfrc_applied[0] = -INERTIA * air * abs(state.qvel[0]) * state.qvel[0]
            mujoco.mj_step(model, state)
        angles.append(state.qpos[0])
    return np.array(angles)[:, None]


if __name__ == "__main__":
    run_script("pendulum", ("theta1",), EFFECTS, play)
