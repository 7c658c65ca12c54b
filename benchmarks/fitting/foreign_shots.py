"""Shots of the independent simulator worlds/billiards.py, run as a process, on random tables as a camera sees them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.csv

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.whole_shot.shot_segments import ShotSegment, estimate_initial_states
from models.estimation.whole_shot.table_fit import TableFit, search_laws
from models.physics.billiards.simulation.parametrised_shot import ContactModels

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
# Frame rate and scale; a frame is 16 samples of the simulator, in whole steps of 20 us.
FPS, PX_PER_M = 62.5, 350.0
HZ, EVERY = 1000, 16
IDS = ("cue", "yellow", "red")


def draw_table(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Draw realistic parameters of cloth, cushions and balls."""
    return {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)},
        "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": rng.uniform(7.0, 13.0)},
        "cushion_restitution": {"e": rng.uniform(0.75, 0.9)},
        "cushion_friction": {"mu": rng.uniform(0.12, 0.22)},
        "ball_restitution": {"e": rng.uniform(0.92, 0.97)},
    }


def draw_shot(
    rng: np.random.Generator, effects: dict[str, dict[str, float]], law: str, seconds: float
) -> dict[str, object]:
    """Draw a shot: a cue ball with arbitrary spin, aimed at the second ball."""
    radius = TABLE.ball_radius
    while True:
        places = rng.uniform([0.15, 0.15], [2.39, 1.12], (3, 2))
        if min(np.hypot(*(places[a] - places[b])) for a, b in ((0, 1), (0, 2), (1, 2))) > 0.25:
            break
    aim = places[1] - places[0]
    angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-1.6, 1.6) * radius / np.hypot(*aim)
    v = rng.uniform(1.2, 3.0) * np.array([np.cos(angle), np.sin(angle)])
    roll, side = rng.uniform(0.0, 0.9), rng.uniform(-0.6, 0.6) * np.hypot(*v) / radius
    balls: list[dict[str, object]] = [
        {"id": name, "x": x, "y": y, "radius": radius} for name, (x, y) in zip(IDS, places, strict=True)
    ]
    balls[0] |= {"vx": v[0], "vy": v[1], "wx": -roll * v[1] / radius, "wy": roll * v[0] / radius, "wz": side}
    table = {"length": TABLE.length, "width": TABLE.width, "pockets": False}
    return {"scene": "billiards", "table": table, "seconds": seconds + 0.1, "hz": HZ, "balls": balls,
            "effects": effects, "laws": {"cushion": law, "ball": "inelastic"}}  # fmt: skip


def simulate_shot(shot: dict[str, object], folder: Path, seconds: float) -> tuple[FloatArray, list[str]]:
    """Simulate a shot; returns positions (T, 3, 2) m at the frames, and the kinds of all events in that time."""
    (folder / "shot.json").write_text(json.dumps(shot))
    subprocess.run([sys.executable, str(WORLD), str(folder / "shot.json"), str(folder)], check=True)
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    xy = np.stack([rows.column(name).to_numpy() for name in ("x", "y")], axis=1).reshape(-1, len(IDS), 2)
    events = pyarrow.csv.read_csv(folder / "events.csv")
    until = events.column("t").to_numpy() < seconds
    kinds = [kind for kind, early in zip(events.column("kind").to_pylist(), until, strict=True) if early]
    return np.asarray(xy[::EVERY][: round(FPS * seconds)]), kinds


def film_shot(xy: FloatArray, number: int, noise: float, rng: np.random.Generator) -> ShotSegment:
    """Observe a shot with noise; initial states are estimated from the observations alone."""
    measured, t = xy + noise * rng.normal(size=xy.shape), np.arange(len(xy)) / FPS
    start, moving = estimate_initial_states(t, measured, np.full(xy.shape[:2], noise))
    whiten = np.broadcast_to(np.eye(2) / noise, (*xy.shape[:2], 2, 2))
    return ShotSegment(number, 0.0, t, measured, whiten, start, moving)


def fit_table(segments: tuple[ShotSegment, ...], candidates: tuple[ContactModels, ...]) -> TableFit:
    """Fit shots with every pair of contact models to the end; returns the fit of greatest evidence."""
    return search_laws(segments, TABLE, candidates=candidates, is_sampled=False).best
