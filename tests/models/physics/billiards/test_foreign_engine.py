"""Random shots against worlds/billiards.py, an engine of small fixed steps that shares no code with this one."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from models.core.typing import FloatArray
from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import TABLE_PRESETS

WORLD = Path(__file__).resolve().parents[4] / "worlds" / "billiards.py"
TABLE = TABLE_PRESETS["carom-match"]
RADIUS, MASS = 0.03, 0.2
AFTER_SECOND_CONTACT = 0.3
"""s."""
EFFECTS = {
    "sliding_friction": {"mu": 0.21}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
    "slope": {"slope_x": 1.0, "slope_y": -0.5}, "cushion_restitution": {"e": 0.85}, "cushion_friction": {"mu": 0.2},
    "ball_restitution": {"e": 0.95},
}  # fmt: skip
"""Sliding friction is the 0.21 that the foreign cushion law has under the nose."""


def shots(seed: int, count: int) -> list[FloatArray]:
    """Draw states (4, 7): a cue ball with spin and three balls at rest, far enough apart."""
    rng, states = np.random.default_rng(seed), []
    while len(states) < count:
        state = np.zeros((4, 7))
        state[:, :2] = rng.uniform(0.1, [TABLE.length - 0.1, TABLE.width - 0.1], (4, 2))
        way = state[1, :2] - state[0, :2] + rng.normal(0, 0.02, 2)
        state[0, 2:4] = rng.uniform(1, 4) * way / np.linalg.norm(way)
        state[0, 4:] = rng.normal(0, 30, 3)
        apart = np.linalg.norm(state[:, None, :2] - state[None, :, :2], axis=-1)[np.triu_indices(4, 1)]
        if apart.min() > 0.15:
            states.append(state)
    return states


LAWS = (
    ("mirror", "inelastic", None),
    ("mirror", "alciatore", None),
    ("mathavan_2010", "inelastic", None),
    ("mathavan_2010", "inelastic", 1.15),
    ("han_2005", "inelastic", None),
    ("han_2005", "inelastic", 1.4),
)
"""Cushion model, ball model, and height of the nose in ball radii where it is not the default."""


def describe_shot(
    state: FloatArray, laws: dict[str, str], seconds: float, effects: dict[str, dict[str, float]]
) -> dict[str, object]:
    """Describe a shot to the foreign engine, which samples it 250 times a second."""
    names = ("x", "y", "vx", "vy", "wx", "wy", "wz")
    balls = [
        {"id": str(k), **dict(zip(names, map(float, row), strict=True)), "radius": RADIUS, "mass": MASS}
        for k, row in enumerate(state)
    ]
    table = {"length": TABLE.length, "width": TABLE.width, "pockets": False}
    return {"table": table, "seconds": seconds, "hz": 250, "balls": balls, "effects": effects, "laws": laws}


def simulate_by_foreign_engine(folder: Path, shots: list[dict[str, object]]) -> list[tuple[FloatArray, FloatArray]]:
    """Simulate all shots in one process: times (T,) and places (T, 4, 2) of each."""
    arguments, results = [], []
    for k, shot in enumerate(shots):
        (folder / f"{k}.json").write_text(json.dumps(shot))
        arguments += [folder / f"{k}.json", folder / str(k)]
    subprocess.run([sys.executable, WORLD, *arguments], check=True)
    for out in arguments[1::2]:
        with (out / "trajectory.csv").open() as file:
            rows = [(float(row["t"]), float(row["x"]), float(row["y"])) for row in csv.DictReader(file)]
        samples = np.array(rows).reshape(-1, 4, 3)
        results.append((samples[:, 0, 0], samples[..., 1:]))
    return results


def test_shots_agree_with_a_foreign_engine_until_after_the_second_contact(tmp_path: Path) -> None:
    runs, described, laws = [], [], []
    for cushion, ball, height in LAWS:
        effects = EFFECTS if height is None else {**EFFECTS, "cushion_height": {"ratio": height}}
        physics = Physics.from_effects(effects, cushion, ball)
        for state in shots(7, 5):
            run = simulate(BallSet(tuple("0123"), state, np.full(4, RADIUS), np.full(4, MASS)), TABLE, physics, 4.0)
            second = run.contacts[1, 1] if len(run.contacts) > 1 else 3.0
            seconds = min(second + AFTER_SECOND_CONTACT, 4.0)
            runs.append(run)
            described.append(describe_shot(state, {"cushion": cushion, "ball": ball}, seconds, effects))
            laws.append((cushion, ball, height))
    foreign = simulate_by_foreign_engine(tmp_path, described)
    for run, law, (t, places) in zip(runs, laws, foreign, strict=True):
        assert np.abs(places - run.states_at(t)[..., :2]).max() < 1e-3, law
