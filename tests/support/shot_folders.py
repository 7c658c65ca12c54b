"""Track folders of simulated shots of one spinning ball, which teach a table."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from models.core.scene import Table
from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics

R, FPS, SECONDS = 0.03075, 50, 5.0
TABLE = Table("carom", "carom", 2.84, 1.42, R, 0.21, False)
EFFECTS = {
    "sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.006}, "spin_decay": {"rate": 5.0},
    "cushion_restitution": {"e": 0.9}, "cushion_friction": {"mu": 0.22}, "ball_restitution": {"e": 0.94},
}  # fmt: skip


def write_shots(folder: Path, count: int, length: float = 2.84, effects: dict[str, dict[str, float]] = EFFECTS) -> Path:
    """Write shots of one spinning ball that meets several cushions, with 0.5 mm of noise."""
    folder.mkdir(parents=True)
    physics = Physics.from_effects(effects, "han_2005", "inelastic")
    with (folder / "tracks.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("shot", "frame", "t", "id", "x", "y"))
        for shot in range(count):
            rng = np.random.default_rng([5, shot])
            angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 3.0)
            v = speed * np.array([np.cos(angle), np.sin(angle)])
            spin = [-v[1] / R, v[0] / R, rng.uniform(-0.6, 0.6) * speed / R]
            state = np.array([[rng.uniform(0.6, 2.2), rng.uniform(0.4, 1.0), *v, *spin]])
            run = simulate(BallSet(("white",), state, np.array([R]), np.array([0.21])), TABLE, physics, SECONDS)
            t = np.arange(int(SECONDS * FPS)) / FPS
            for frame, place in enumerate(run.states_at(t)[:, 0, :2] + rng.normal(0, 5e-4, (len(t), 2))):
                rows.writerow((shot, frame, t[frame], "white", *place))
    scene: dict[str, Any] = {
        "scene": "billiards", "units": "m", "fps": FPS, "ball_radius": R,
        "table": {"length": length, "width": 1.42, "pockets": False},
    }  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder
