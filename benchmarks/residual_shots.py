"""Lone balls on foreign tables: shots of `worlds/billiards.py` as a camera sees them, and what a simulator may lack."""

from __future__ import annotations

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.whole_shot.cushion_chains import Bounce, Leg
from worlds.billiards import CUSHION, play

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
FPS, NOISE, HZ, SECONDS = 30.0, 0.001, 120, 3.2
"""Pictures per s, m per axis, samples of the world per s, s of a shot."""
TIMING = 0.002
"""s, error of the times of contacts that are given."""
SCATTER = 0.01
"""of the speed, allowed for at a cushion."""
LACKING = ("nothing", "slope", "mathavan", "speed")
"""What these tables have and the fitted physics lacks: nothing; a tilt of 1 to 3 mm/m; cushions by Mathavan 2010 where
the physics has a mirror with friction; restitution that falls by 0.06 to 0.1 per m/s."""


def filmed(lacking: str, seed: int, shots: int) -> list[tuple[Leg, ...]]:
    """The legs of every shot on one table."""
    rng = np.random.default_rng([LACKING.index(lacking), seed])
    effects, law = _table(lacking, rng)
    return [_legs(_played(rng, effects, law), shot, rng) for shot in range(shots)]


def _table(lacking: str, rng: np.random.Generator) -> tuple[dict[str, dict[str, float]], str]:
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.17, 0.23)},
        "rolling_resistance": {"mu": rng.uniform(0.008, 0.012)},
        "cushion_restitution": {"e": rng.uniform(0.8, 0.9)},
        "cushion_friction": {"mu": rng.uniform(0.14, 0.2)},
    }
    if lacking == "slope":
        angle, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 3.0)
        effects["slope"] = {"slope_x": tilt * np.cos(angle), "slope_y": tilt * np.sin(angle)}
    if lacking == "speed":
        effects["cushion_restitution"]["e"] = 0.95
        effects["cushion_restitution_speed"] = {"slope": rng.uniform(0.06, 0.1)}
    return effects, "mathavan_2010" if lacking == "mathavan" else "mirror"


def _played(rng: np.random.Generator, effects: dict[str, dict[str, float]], law: str) -> tuple[FloatArray, FloatArray]:
    """Samples (T, 2) at `HZ` and events of a ball struck at 0.8 to 3 m/s above or below its middle.

    No shot has side spin from the cue, which no path shows before a cushion: it would decide every prediction.
    """
    angle, speed, roll = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 3.0), rng.uniform(-0.3, 1.0)
    v, radius = speed * np.array([np.cos(angle), np.sin(angle)]), TABLE.ball_radius
    place = rng.uniform([0.2, 0.2], [TABLE.length - 0.2, TABLE.width - 0.2])
    ball = {"id": "cue", "x": place[0], "y": place[1], "vx": v[0], "vy": v[1], "wx": -roll * v[1] / radius,
            "wy": roll * v[0] / radius, "wz": 0.0, "radius": radius}  # fmt: skip
    shot = {"balls": [ball], "table": {"length": TABLE.length, "width": TABLE.width}, "effects": effects,
            "laws": {"cushion": law}, "seconds": SECONDS, "hz": HZ}  # fmt: skip
    samples, events = play(shot, 1e-4)
    return samples[:, 0, :2], events[events[:, 0] == CUSHION]


def _legs(played: tuple[FloatArray, FloatArray], number: int, rng: np.random.Generator) -> tuple[Leg, ...]:
    xy, events = played
    every = round(HZ / FPS)
    seen = xy[::every] + NOISE * rng.standard_normal(xy[::every].shape)
    t = np.arange(len(seen)) / FPS
    met = events[:, 1] + TIMING * rng.standard_normal(len(events))
    begins, ends = np.concatenate([[0.0], met]), np.append(met, np.inf)
    legs = []
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        inside = (t >= begin + (k > 0) / (2 * FPS)) & (t <= end - 1 / (2 * FPS))
        bounce = Bounce(CUSHIONS[int(events[k, 3])], float(end)) if k < len(events) else None
        whiten = np.tile(np.eye(2) / NOISE, (int(inside.sum()), 1, 1))
        legs.append(Leg(number, "cue", float(begin), k > 0, t[inside], seen[inside], whiten, bounce))
    return tuple(legs)
