"""Simulate thrown bodies in a plane whose y is the height. `worlds/filming.py` describes the command.

Gravity always acts. Drag is relative to the air, which moves with the `wind`; `magnus` is lift by spin. Effects that
are in no library: `gust` (oscillating wind), and `drag_power` (a drag -k v^power).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from filming import STILL, Effects, Floats, Throw, Waves, integrate_motion, run_script

GRAVITY = 9.81
# Drag with which wind acts on a body without other drag, 1/s.
LEAST_DRAG = 0.1
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "air_drag": ("k",),
    "viscous_drag": ("k",),
    "wind": ("wind_x",),
    "magnus": ("s",),
    "gust": ("speed", "period"),
    "drag_power": ("k", "power"),
}


def play_in_space(effects: Effects, chance: np.random.Generator, t: Floats, axis: Floats) -> Floats:
    """Return positions (T, 3) m of a body that is thrown up in any direction and spins about an axis (3,)."""
    speed, steep, side = chance.uniform(6.0, 12.0), np.radians(chance.uniform(35.0, 80.0)), chance.uniform(0, 2 * np.pi)
    air, spin = effects.get("air_drag", {}).get("k", 0.0), effects.get("magnus", {}).get("s", 0.0)

    def force(_: float, where: Floats, v: Floats) -> Floats:
        pull: Floats = spin * np.cross(axis, v) - air * np.linalg.norm(v) * v - np.array([0.0, 0.0, GRAVITY])
        return pull

    along = np.array([np.cos(steep) * np.cos(side), np.cos(steep) * np.sin(side), np.sin(steep)])
    return integrate_motion(force, np.array([0.0, 0.0, chance.uniform(1.0, 2.0)]), speed * along, t)


def play(effects: Effects, throw: Throw, chance: np.random.Generator, t: Floats, waves: Waves = STILL) -> Floats:
    """Return positions (T, 2) m of a body that is thrown up at an angle, to either side; (T, 3) with a spin axis."""
    if waves.drive:
        axis = np.array([waves.evaluate(f"axis_{name}", 0.0) for name in "xyz"])
        return play_in_space(effects, chance, t, axis / np.linalg.norm(axis))
    drawn = {"speed": chance.uniform(6.0, 12.0), "angle": np.radians(chance.uniform(35.0, 80.0))}
    speed, angle = throw.get("speed", drawn["speed"]), throw.get("angle", drawn["angle"])
    side = chance.choice([-1.0, 1.0])
    air, viscous = (effects.get(name, {}).get("k", 0.0) for name in ("air_drag", "viscous_drag"))
    wind, spin = effects.get("wind", {}).get("wind_x", 0.0), effects.get("magnus", {}).get("s", 0.0)
    gust, between = effects.get("gust", {}), effects.get("drag_power", {})
    light = LEAST_DRAG if (wind or gust) and not (air or viscous) else 0.0

    def force(now: float, where: Floats, v: Floats) -> Floats:
        blown = wind + (gust["speed"] * np.sin(2 * np.pi * now / gust["period"]) if gust else 0.0)
        against = v - np.array([blown, 0.0])
        pull: Floats = -(air * np.hypot(*against) + viscous + light) * against + spin * np.array([-v[1], v[0]])
        if between:
            pull = pull - between["k"] * np.hypot(*against) ** (between["power"] - 1) * against
        return pull - np.array([0.0, GRAVITY])

    start = np.array([0.0, chance.uniform(1.0, 2.0)])
    return integrate_motion(force, start, speed * np.array([side * np.cos(angle), np.sin(angle)]), t)


if __name__ == "__main__":
    run_script("flight", ("x", "y", "z"), EFFECTS, play)
