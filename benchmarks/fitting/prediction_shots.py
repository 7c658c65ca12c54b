"""Shots of three balls for predictions: truth from an independent simulator, and noisy tracks of it."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.csv

from benchmarks.fitting.ball_pairs import LENGTH, PX_PER_M, WIDTH, R, overhead_scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
# Frames per second, noise in m per axis, seconds filmed before the strike.
FPS, NOISE, LEAD = 60.0, 1e-3, 0.2
HZ, SECONDS = 1000, 6.0
IDS = ("cue", "yellow", "red")
LAWS = ("mirror", "mathavan_2010")

__all__ = ["IDS", "LAWS", "LEAD", "SECONDS", "SimulatedShot", "film_shot", "overhead_scene", "simulate_shot"]


@dataclass(frozen=True, slots=True)
class SimulatedShot:
    """Motion of the balls, sampled every millisecond."""

    name: str
    t: FloatArray
    """(T,) s of the film."""
    xy: FloatArray
    """(T, 3, 2) m."""
    contacts: FloatArray
    """(E,) s."""


def _draw_shot(seed: int, law: str) -> dict[str, object]:
    """Draw a cue ball at 1.2 to 3.5 m/s with arbitrary spin, aimed near the second of three balls."""
    rng = np.random.default_rng([2022, seed])
    while True:
        places = rng.uniform([0.2, 0.2], [LENGTH - 0.2, WIDTH - 0.2], (3, 2))
        if min(np.hypot(*(places[a] - places[b])) for a, b in ((0, 1), (0, 2), (1, 2))) > 0.15:
            break
    aim = places[1] - places[0]
    angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-1, 1) * 2.5 * R / np.hypot(*aim)
    v = rng.uniform(1.2, 3.5) * np.array([np.cos(angle), np.sin(angle)])
    roll = rng.uniform(-0.3, 1.0)
    spin = {"wx": -roll * v[1] / R, "wy": roll * v[0] / R, "wz": rng.uniform(-15.0, 15.0)}
    balls: list[dict[str, object]] = [
        {"id": name, "x": x, "y": y, "radius": R} for name, (x, y) in zip(IDS, places, strict=True)
    ]
    balls[0] |= {"vx": v[0], "vy": v[1], **spin}
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)},
        "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": 10.0},
        "cushion_restitution": {"e": rng.uniform(0.75, 0.9)},
        "cushion_friction": {"mu": 0.2},
        "ball_restitution": {"e": rng.uniform(0.93, 0.97)},
    }
    table = {"length": LENGTH, "width": WIDTH, "pockets": False}
    laws = {"cushion": law, "ball": "alciatore"}
    return {"scene": "billiards", "table": table, "seconds": SECONDS, "hz": HZ, "balls": balls, "effects": effects,
            "laws": laws}  # fmt: skip


def simulate_shot(seed: int, law: str, folder: Path) -> SimulatedShot:
    """Return the shot of a seed, from `folder` or from the simulator, which runs as a process."""
    out = folder / f"shot_{seed}_{law}"
    if not (out / "events.csv").is_file():
        out.mkdir(parents=True, exist_ok=True)
        (out / "shot.json").write_text(json.dumps(_draw_shot(seed, law)))
        subprocess.run([sys.executable, str(WORLD), str(out / "shot.json"), str(out)], check=True)
    rows = pyarrow.csv.read_csv(out / "trajectory.csv")
    xy = np.stack([rows[name].to_numpy().reshape(-1, len(IDS)) for name in "xy"], axis=2)
    lead = np.repeat(xy[:1], round(LEAD * HZ), axis=0)
    whole = np.concatenate([lead, xy])
    events = pyarrow.csv.read_csv(out / "events.csv")
    met = np.isin(events["kind"].to_pylist(), ("ball", "cushion"))
    return SimulatedShot(f"{law} {seed}", np.arange(len(whole)) / HZ, whole, LEAD + events["t"].to_numpy()[met])


def film_shot(shot: SimulatedShot, until: float, seed: int, noise: float = NOISE) -> Tracks:
    """Observe a shot from straight above until `until` s, with Gaussian noise (m) per axis."""
    rng = np.random.default_rng([7, seed])
    t = np.arange(int(until * FPS + 1e-9) + 1) / FPS
    xy = shot.xy[np.rint(t * HZ).astype(int)]
    xy = xy + rng.normal(0, noise, xy.shape)
    shape = xy.shape[:2]
    sigma = np.full(shape, noise)
    colour = np.array([[90.0, 0.0, 5.0], [80.0, 5.0, 75.0], [45.0, 60.0, 35.0]])
    return Tracks(
        np.arange(len(t)), np.rint(t * HZ) / HZ, IDS, ("white", "yellow", "red"), xy, xy * PX_PER_M + 30, sigma, sigma,
        np.zeros_like(xy), np.full(shape, R * PX_PER_M), colour,
    )  # fmt: skip
