"""Whole shots of a foreign world: what a fit by shooting tells of the table, and whether it names the right law.

    PYTHONPATH=. python benchmarks/shots.py [SEEDS] [FIRST]

The truth is worlds/billiards.py, run as a process: a table of its own per seed, three shots of three balls, 62.5
pictures a second, noise of 0.3 and 1 px at 350 px to the metre. Printed per seed: the law of the truth and the one that
is named, chi2 per degree of freedom, and (found - true) / sigma of every number; at the end, over all seeds in which
the right law was named, the median and the root mean square of these pulls, and how many lie within 3. Nothing but the
tracks is used: first guesses come from them. In the world of Mathavan's law the cloth under a pressed ball has a
friction of its own, 0.21, which the law here takes from the cloth.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.csv
from numpy.typing import NDArray

from models.billiards.beginnings import beginning
from models.billiards.playing import Laws
from models.billiards.stretches import Stretch
from models.billiards.whole_fit import TableFit, fit_table
from models.scene import Table

Floats = NDArray[np.float64]

WORLD = Path(__file__).resolve().parent.parent / "worlds" / "billiards.py"
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
FPS, SECONDS, SHOTS, PX_PER_M = 62.5, 2.0, 3, 350.0
"""Pictures a second: 16 samples of the world, which makes whole steps of 20 us."""
HZ, EVERY = 1000, 16
IDS = ("cue", "yellow", "red")
LAWS = ("mirror", "mathavan_2010")


def table_of(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Cloth, cushions and balls as tables have them."""
    return {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)},
        "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": rng.uniform(7.0, 13.0)},
        "cushion_restitution": {"e": rng.uniform(0.75, 0.9)},
        "cushion_friction": {"mu": rng.uniform(0.12, 0.22)},
        "ball_restitution": {"e": rng.uniform(0.92, 0.97)},
    }


def shot_of(rng: np.random.Generator, effects: dict[str, dict[str, float]], law: str) -> dict[str, object]:
    """A cue ball with any spin, played at the second ball."""
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
    return {"scene": "billiards", "table": table, "seconds": SECONDS + 0.1, "hz": HZ, "balls": balls,
            "effects": effects, "laws": {"cushion": law, "ball": "inelastic"}}  # fmt: skip


def played(shot: dict[str, object], folder: Path) -> Floats:
    """(T, 3, 2) m, at the pictures of the film."""
    (folder / "shot.json").write_text(json.dumps(shot))
    subprocess.run([sys.executable, str(WORLD), str(folder / "shot.json"), str(folder)], check=True)
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    xy = np.stack([rows.column(name).to_numpy() for name in ("x", "y")], axis=1).reshape(-1, len(IDS), 2)
    return np.asarray(xy[::EVERY][: round(FPS * SECONDS)])


def filmed(xy: Floats, number: int, noise: float, rng: np.random.Generator) -> Stretch:
    """What a camera gives of it, begun from that alone."""
    seen, t = xy + noise * rng.normal(size=xy.shape), np.arange(len(xy)) / FPS
    start, moving = beginning(t, seen, np.full(xy.shape[:2], noise))
    whiten = np.broadcast_to(np.eye(2) / noise, (*xy.shape[:2], 2, 2))
    return Stretch(number, 0.0, t, seen, whiten, start, moving)


def pulls(fitted: TableFit, effects: dict[str, dict[str, float]]) -> dict[str, float]:
    """(found - true) / sigma of every number that the data determined."""
    truth = {f"{effect}.{name}": value for effect, numbers in effects.items() for name, value in numbers.items()}
    truth |= {"ball_friction.mu": 0.0, "collision_radius.factor": 1.0}
    return {
        p.name: (p.value - truth.get(p.name, 0.0)) / p.sigma
        for p in fitted.parameters if not p.prior_only and p.name != "ball_friction.mu"
    }  # fmt: skip


def case(seed: int, law: str, noise_px: float) -> tuple[TableFit, dict[str, float]]:
    """One table, its shots filmed and fitted under all laws."""
    rng = np.random.default_rng([2022, seed])
    effects = table_of(rng)
    with tempfile.TemporaryDirectory() as folder:
        paths = [played(shot_of(rng, effects, law), Path(folder)) for _ in range(SHOTS)]
    stretches = tuple(filmed(xy, k, noise_px / PX_PER_M, rng) for k, xy in enumerate(paths))
    fitted = fit_table(stretches, TABLE, tuple(Laws(one, "inelastic") for one in LAWS))
    return fitted, pulls(fitted, effects)


def main(seeds: int = 20, first: int = 0) -> None:
    for noise_px in (0.3, 1.0):
        for law in LAWS:
            found: dict[str, list[float]] = {}
            right, good, seconds = 0, 0, time.process_time()
            for seed in range(first, first + seeds):
                fitted, told = case(seed, law, noise_px)
                right += fitted.laws.cushion == law
                good += fitted.chi2_per_dof < 1.2
                print(f"{noise_px} px {law:14} seed {seed:2} named {fitted.laws.cushion:14}"
                      f" chi2 {fitted.chi2_per_dof:6.2f} " + " ".join(f"{k} {v:+.1f}" for k, v in told.items()),
                      flush=True)  # fmt: skip
                if fitted.laws.cushion == law:
                    for name, pull in told.items():
                        found.setdefault(name, []).append(pull)
            print(f"{noise_px} px {law}: law right {right} of {seeds}, chi2 below 1.2 {good} of {seeds},"
                  f" {(time.process_time() - seconds) / seeds:.1f} CPU s a table")  # fmt: skip
            for name, values in found.items():
                some = np.array(values)
                print(f"  {name:26} median {np.median(some):+6.2f} rms {np.sqrt(np.mean(some**2)):7.2f}"
                      f" within 3: {int((abs(some) < 3).sum())} of {len(some)}")  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
