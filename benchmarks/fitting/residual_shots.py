"""Single balls on simulated tables (worlds/billiards.py) as a camera sees them, and effects missing in a simulator."""

from __future__ import annotations

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.whole_shot.cushion_chains import ChainSegment, CushionBounce
from worlds.billiards import CUSHION, play

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
FPS, NOISE, HZ, SECONDS = 30.0, 0.001, 120, 3.2
"""Frames per second, noise in m per axis, samples of the simulator per second, seconds of a shot."""
TIMING = 0.002
"""Standard deviation of the given contact times, s."""
SCATTER = 0.01
"""Allowed scatter at a cushion, as a share of the speed."""
MISSING_EFFECTS = ("nothing", "slope", "mathavan", "speed")
"""Effects of these tables that the fitted physics does not have.

None; a tilt of 1 to 3 mm/m; cushions by Mathavan 2010 where the physics has a mirror with friction; restitution that
falls by 0.06 to 0.1 per m/s.
"""


def film_table(lacking: str, seed: int, shots: int) -> list[tuple[ChainSegment, ...]]:
    """Play and observe shots on one table; returns the segments of every shot."""
    rng = np.random.default_rng([MISSING_EFFECTS.index(lacking), seed])
    effects, law = _draw_table(lacking, rng)
    return [_observe_segments(_play_shot(rng, effects, law), shot, rng) for shot in range(shots)]


def _draw_table(lacking: str, rng: np.random.Generator) -> tuple[dict[str, dict[str, float]], str]:
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


def _play_shot(
    rng: np.random.Generator, effects: dict[str, dict[str, float]], law: str
) -> tuple[FloatArray, FloatArray]:
    """Play a ball struck at 0.8 to 3 m/s; returns samples (T, 2) m at `HZ`, and cushion events.

    No shot has side spin from the cue: it is invisible before a cushion and would dominate every prediction.
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


def _observe_segments(
    shot: tuple[FloatArray, FloatArray], number: int, rng: np.random.Generator
) -> tuple[ChainSegment, ...]:
    xy, events = shot
    every = round(HZ / FPS)
    measured = xy[::every] + NOISE * rng.standard_normal(xy[::every].shape)
    t = np.arange(len(measured)) / FPS
    contact_times = events[:, 1] + TIMING * rng.standard_normal(len(events))
    begins, ends = np.concatenate([[0.0], contact_times]), np.append(contact_times, np.inf)
    segments = []
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        inside = (t >= begin + (k > 0) / (2 * FPS)) & (t <= end - 1 / (2 * FPS))
        bounce = CushionBounce(CUSHIONS[int(events[k, 3])], float(end)) if k < len(events) else None
        whiten = np.tile(np.eye(2) / NOISE, (int(inside.sum()), 1, 1))
        segments.append(ChainSegment(number, "cue", float(begin), k > 0, t[inside], measured[inside], whiten, bounce))
    return tuple(segments)
