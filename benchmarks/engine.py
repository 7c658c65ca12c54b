"""The billiards engine: what it conserves under every law, how near a foreign engine comes, and what a break costs.

    PYTHONPATH=. python benchmarks/engine.py [--shots N] [--breaks N]

First table, per law: by how much energy grows at most from one moment to the next (less than 0: it always falls) and
what contacts between balls change of momentum, as shares, and how far (mm) mirrored and shifted shots come from the
mirrored and shifted ones, within a second. Second: the largest distance (mm) of any ball from worlds/billiards.py, run
as a process, until 0.3 s after the second contact; sliding, spinning, rolling, a table that leans, cushions and balls.
Third: CPU ms of a nine-ball break of 10 s, after one shot for warming up, and of that first shot in a fresh process.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.parameters import BALL_LAWS, CUSHION_LAWS, SLOPE_Y, Physics
from models.physics.billiards.simulation.event_engine import BALL, FIRST, KIND, SECOND, TIME
from models.physics.billiards.simulation.simulate_shot import Balls, energy, simulate
from models.physics.billiards.tables import PRESETS

HERE = Path(__file__).resolve().parent
WORLD = HERE.parent / "worlds" / "billiards.py"
TABLE, POOL = PRESETS["carom-match"], PRESETS["pool-9ft"]
RADIUS, MASS = 0.03, 0.2
AFTER_SECOND_CONTACT = 0.3
"""s."""
HZ = 250
SHIFT = np.array([0.013, -0.007])
"""m."""
NOSES_SHIFTED = np.array([-0.013, 0.013, 0.007, -0.007])
"""m outwards: the same, of the left, right, top and bottom nose."""
EFFECTS = {
    "sliding_friction": {"mu": 0.21}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
    "slope": {"slope_x": 1.0, "slope_y": -0.5}, "cushion_restitution": {"e": 0.85}, "cushion_friction": {"mu": 0.2},
    "ball_restitution": {"e": 0.95},
}  # fmt: skip
"""Sliding friction is the 0.21 that the foreign cushion law has under the nose."""
SHARED_LAWS = (("mirror", "inelastic"), ("mirror", "alciatore"), ("mathavan_2010", "inelastic"))
"""Those that the foreign engine has too."""
BREAK = """
import time
from engine import physics_of, rack, simulate, POOL
begun = time.process_time()
simulate(rack(1), POOL, physics_of("mathavan_2010", "inelastic", level=True), 10.0)
print(1e3 * (time.process_time() - begun))
"""
"""The first shot of a process, ms."""


def physics_of(cushion: str, ball: str, level: bool = False) -> Physics:
    """The same table under other laws."""
    left_out = (("ball_restitution",) if ball == "elastic" else ()) + (("slope",) if level else ())
    return Physics.of({name: value for name, value in EFFECTS.items() if name not in left_out}, cushion, ball)


def opening(rng: np.random.Generator) -> Balls:
    """A cue ball with spin, played at one of three balls at rest that are far enough apart."""
    while True:
        state = np.zeros((4, 7))
        state[:, :2] = rng.uniform(0.1, [TABLE.length - 0.1, TABLE.width - 0.1], (4, 2))
        way = state[1, :2] - state[0, :2] + rng.normal(0, 0.02, 2)
        state[0, 2:4] = rng.uniform(1, 4) * way / np.linalg.norm(way)
        state[0, 4:] = rng.normal(0, 30, 3)
        apart = np.linalg.norm(state[:, None, :2] - state[None, :, :2], axis=-1)[np.triu_indices(4, 1)]
        if apart.min() > 0.15:
            return Balls(tuple("0123"), state, np.full(4, RADIUS), np.full(4, MASS))


def rack(seed: int) -> Balls:
    """A nine-ball rack that is not quite tight, and a cue ball of 8 m/s."""
    rng, apart = np.random.default_rng(seed), 2 * POOL.ball_radius + 1e-4
    state = np.zeros((10, 7))
    state[0, :4] = 0.6, POOL.width / 2 + rng.normal(0, 3e-3), 8.0, rng.normal(0, 0.05)
    places = [(row, k - (count - 1) / 2) for row, count in enumerate((1, 2, 3, 2, 1)) for k in range(count)]
    state[1:, :2] = [0.75 * POOL.length, POOL.width / 2] + apart * np.array(places) * [np.sqrt(0.75), 1.0]
    state[1:, :2] += rng.normal(0, 1e-5, (9, 2))
    return Balls(tuple("0123456789"), state, np.full(10, POOL.ball_radius), np.full(10, POOL.ball_mass))


def kept(physics: Physics, balls: Balls) -> tuple[float, float, float, float]:
    """Growth of energy and change of momentum, shares; distances from the mirrored and from the shifted shot, mm."""
    t = np.linspace(0.0, 1.0, 201)
    run = simulate(balls, TABLE, physics, 1.0)
    joules = energy(run.at(t), balls.radius, balls.mass).sum(axis=1)
    changes = [0.0]
    for row in run.contacts[run.contacts[:, KIND] == BALL]:
        pair = row[[FIRST, SECOND]].astype(int)
        before, after = (run.at(row[TIME] + late)[pair, 2:4].sum(axis=0) for late in (-1e-9, 1e-9))
        changes.append(float(np.abs(after - before).max() / np.abs(before).max()))
    mirrored = balls.state * [1, -1, 1, -1, -1, 1, -1] + [0, TABLE.width, 0, 0, 0, 0, 0]
    tilted = replace(physics, values=physics.values * np.where(np.arange(len(physics.values)) == SLOPE_Y, -1.0, 1.0))
    image = simulate(replace(balls, state=mirrored), TABLE, tilted, 1.0).at(t)[..., :2] * [1, -1] + [0, TABLE.width]
    moved = replace(balls, state=balls.state + np.concatenate([SHIFT, np.zeros(5)]))
    shifted = simulate(moved, TABLE, physics, 1.0, NOSES_SHIFTED).at(t)
    return (
        float(np.diff(joules).max() / joules[0]), max(changes), 1e3 * float(np.abs(image - run.at(t)[..., :2]).max()),
        1e3 * float(np.abs(shifted[..., :2] - SHIFT - run.at(t)[..., :2]).max()),
    )  # fmt: skip


def table_of_symmetries(shots: int) -> None:
    print("| cushion | ball | energy grows by | momentum changes by | mirrored, mm | shifted, mm |")
    print("|---|---|---|---|---|---|")
    for laws in product(CUSHION_LAWS, BALL_LAWS):
        rng = np.random.default_rng(11)
        worst = np.max([kept(physics_of(*laws), opening(rng)) for _ in range(shots)], axis=0)
        print(f"| {' | '.join(laws)} | {' | '.join(f'{one:.1e}' for one in worst)} |", flush=True)


def foreign(balls: list[Balls], laws: tuple[str, str], seconds: list[float], folder: Path) -> list[FloatArray]:
    """Places (T, 4, 2) of every shot as the foreign engine has them, `HZ` a second."""
    words, names = [], ("x", "y", "vx", "vy", "wx", "wy", "wz")
    for number, (one, last) in enumerate(zip(balls, seconds, strict=True)):
        told = [
            {"id": name, **dict(zip(names, map(float, row), strict=True)), "radius": RADIUS, "mass": MASS}
            for name, row in zip(one.ids, one.state, strict=True)
        ]
        shot = {
            "table": {"length": TABLE.length, "width": TABLE.width, "pockets": False}, "seconds": last, "hz": HZ,
            "balls": told, "effects": EFFECTS, "laws": dict(zip(("cushion", "ball"), laws, strict=True)),
        }  # fmt: skip
        out = folder / str(number)
        out.mkdir(parents=True, exist_ok=True)
        (out / "shot.json").write_text(json.dumps(shot))
        words += [str(out / "shot.json"), str(out)]
    subprocess.run([sys.executable, str(WORLD), *words], check=True)
    return [_places(folder / str(number)) for number in range(len(balls))]


def _places(folder: Path) -> FloatArray:
    with (folder / "trajectory.csv").open() as file:
        rows = [(float(row["x"]), float(row["y"])) for row in csv.DictReader(file)]
    return np.array(rows).reshape(-1, 4, 2)


def table_of_foreign_shots(shots: int) -> None:
    print("\n| cushion | ball | shots | median mm | worst mm (goal 1) |\n|---|---|---|---|---|")
    for laws in SHARED_LAWS:
        rng = np.random.default_rng(7)
        balls = [opening(rng) for _ in range(shots)]
        runs = [simulate(one, TABLE, physics_of(*laws), 4.0) for one in balls]
        ends = [min(r.contacts[1, TIME] + AFTER_SECOND_CONTACT if len(r.contacts) > 1 else 3.3, 4.0) for r in runs]
        with tempfile.TemporaryDirectory() as folder:
            there = foreign(balls, laws, ends, Path(folder))
        apart = [
            1e3 * float(np.linalg.norm(places - run.at(np.arange(len(places)) / HZ)[..., :2], axis=-1).max())
            for places, run in zip(there, runs, strict=True)
        ]
        print(f"| {' | '.join(laws)} | {shots} | {np.median(apart):.3f} | {max(apart):.3f} |", flush=True)


def cost(balls: Balls, table: Table, physics: Physics) -> tuple[float, int, int]:
    """CPU ms, contacts and events of a shot of 10 s."""
    begun = time.process_time()
    run = simulate(balls, table, physics, 10.0)
    return 1e3 * (time.process_time() - begun), len(run.contacts), len(run.events)


def table_of_breaks(breaks: int) -> None:
    print("\n| cushion law | table | breaks | contacts, median | events, median | CPU ms, median | worst (goal 15) |")
    print("|---|---|---|---|---|---|---|")
    tables = {"level": (POOL, True), "level, no pockets": (replace(POOL, pockets=False), True), "leans": (POOL, False)}
    for cushion, (name, (table, level)) in product(CUSHION_LAWS, tables.items()):
        physics = physics_of(cushion, "inelastic", level)
        simulate(rack(0), table, physics, 10.0)
        costs, contacts, events = np.array([cost(rack(seed), table, physics) for seed in range(1, breaks + 1)]).T
        print(f"| {cushion} | {name} | {breaks} | {np.median(contacts):.0f} | {np.median(events):.0f} "
              f"| {np.median(costs):.1f} | {max(costs):.1f} |", flush=True)  # fmt: skip
    fresh = subprocess.run([sys.executable, "-c", BREAK], check=True, capture_output=True, text=True, cwd=HERE)
    print(f"\nfirst break of a fresh process, compiled code taken from disk: {float(fresh.stdout):.0f} CPU ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shots", type=int, default=20, help="per law")
    parser.add_argument("--breaks", type=int, default=20, help="per cushion law")
    given = parser.parse_args()
    table_of_symmetries(given.shots)
    table_of_foreign_shots(given.shots)
    table_of_breaks(given.breaks)


if __name__ == "__main__":
    main()
