"""Check what the billiards engine conserves, compare it with an independent engine, and measure the cost of a break.

    python -m benchmarks.physics.engine [--quick] [--shots N] [--breaks N]

First table, per pair of contact models: the largest growth of energy from
one moment to the next (below 0: energy always falls) and the change of momentum in contacts between balls, as shares;
and the distances (mm) of mirrored and shifted shots from the mirrored and shifted originals, within a second. Second
table: the largest distance (mm) of any ball from worlds/billiards.py, run as a process, until 0.3 s after the second
contact; with sliding, spinning, rolling, a tilted table, cushions and ball contacts. Third table: CPU milliseconds of a
nine-ball break of 10 s after a warm-up shot, and of the first shot in a fresh process.
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

from benchmarks.support.figures import (
    Figure,
    add_quick_option,
    estimate_median,
    estimate_share,
    run_quick,
    state_cost,
)
from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.contact_models import BALL_MODELS, CUSHION_MODELS
from models.physics.billiards.parameter_vector import SLOPE_Y
from models.physics.billiards.simulation.event_engine import BALL, EVENT_FIRST, EVENT_KIND, EVENT_SECOND, EVENT_TIME
from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import TABLE_PRESETS

ROOT = Path(__file__).resolve().parents[2]
WORLD = ROOT / "worlds" / "billiards.py"
TABLE, POOL = TABLE_PRESETS["carom-match"], TABLE_PRESETS["pool-9ft"]
RADIUS, MASS = 0.03, 0.2
# Shots per pair of contact models, and breaks, of `--quick`.
QUICK_SHOTS, QUICK_BREAKS = 6, 5
# Share of energy or momentum, and distance of mirrored and shifted shots, that rounding may cause.
CONSERVED, SYMMETRIC_MM = 1e-8, 1e-6
# Time after the second contact until which positions are compared, s.
AFTER_SECOND_CONTACT = 0.3
HZ = 250
# Shift of all balls, m.
TABLE_SHIFT = np.array([0.013, -0.007])
# The same shift of the left, right, top and bottom nose, m outwards.
NOSES_SHIFTED = np.array([-0.013, 0.013, 0.007, -0.007])
# Sliding friction equals the 0.21 that the cushion model of worlds/billiards.py has under the nose.
EFFECTS = {
    "sliding_friction": {"mu": 0.21}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
    "slope": {"slope_x": 1.0, "slope_y": -0.5}, "cushion_restitution": {"e": 0.85}, "cushion_friction": {"mu": 0.2},
    "ball_restitution": {"e": 0.95},
}  # fmt: skip
# Pairs of contact models that worlds/billiards.py has too.
SHARED_MODELS = (
    ("mirror", "inelastic"),
    ("mirror", "alciatore"),
    ("mathavan_2010", "inelastic"),
    ("han_2005", "inelastic"),
)
# Script that prints the CPU milliseconds of the first shot of a process.
FRESH_BREAK = """
import time
from benchmarks.physics.engine import POOL, build_physics, draw_rack, simulate
begun = time.process_time()
simulate(draw_rack(1), POOL, build_physics("mathavan_2010", "inelastic", level=True), 10.0)
print(1e3 * (time.process_time() - begun))
"""


def build_physics(cushion: str, ball: str, level: bool = False) -> Physics:
    """Build the physics of the table with the given contact models."""
    left_out = (("ball_restitution",) if ball == "elastic" else ()) + (("slope",) if level else ())
    return Physics.from_effects({name: value for name, value in EFFECTS.items() if name not in left_out}, cushion, ball)


def draw_opening(rng: np.random.Generator) -> BallSet:
    """Draw a shot: a cue ball with spin, aimed at one of three balls at rest that lie well apart."""
    while True:
        state = np.zeros((4, 7))
        state[:, :2] = rng.uniform(0.1, [TABLE.length - 0.1, TABLE.width - 0.1], (4, 2))
        way = state[1, :2] - state[0, :2] + rng.normal(0, 0.02, 2)
        state[0, 2:4] = rng.uniform(1, 4) * way / np.linalg.norm(way)
        state[0, 4:] = rng.normal(0, 30, 3)
        apart = np.linalg.norm(state[:, None, :2] - state[None, :, :2], axis=-1)[np.triu_indices(4, 1)]
        if apart.min() > 0.15:
            return BallSet(tuple("0123"), state, np.full(4, RADIUS), np.full(4, MASS))


def draw_rack(seed: int) -> BallSet:
    """Draw a nine-ball rack with small gaps and a cue ball of 8 m/s."""
    rng, apart = np.random.default_rng(seed), 2 * POOL.ball_radius + 1e-4
    state = np.zeros((10, 7))
    state[0, :4] = 0.6, POOL.width / 2 + rng.normal(0, 3e-3), 8.0, rng.normal(0, 0.05)
    places = [(row, k - (count - 1) / 2) for row, count in enumerate((1, 2, 3, 2, 1)) for k in range(count)]
    state[1:, :2] = [0.75 * POOL.length, POOL.width / 2] + apart * np.array(places) * [np.sqrt(0.75), 1.0]
    state[1:, :2] += rng.normal(0, 1e-5, (9, 2))
    return BallSet(tuple("0123456789"), state, np.full(10, POOL.ball_radius), np.full(10, POOL.ball_mass))


def measure_symmetries(physics: Physics, balls: BallSet) -> tuple[float, float, float, float]:
    """Return growth of energy, change of momentum (shares), and distances from the mirrored and shifted shot (mm)."""
    t = np.linspace(0.0, 1.0, 201)
    run = simulate(balls, TABLE, physics, 1.0)
    states = run.states_at(t)
    spin = 0.4 * balls.radius**2 * np.sum(states[..., 4:7] ** 2, axis=-1)
    joules = np.sum(0.5 * balls.mass * (np.sum(states[..., 2:4] ** 2, axis=-1) + spin), axis=1)
    changes = [0.0]
    for row in run.contacts[run.contacts[:, EVENT_KIND] == BALL]:
        pair = row[[EVENT_FIRST, EVENT_SECOND]].astype(int)
        before, after = (run.states_at(row[EVENT_TIME] + late)[pair, 2:4].sum(axis=0) for late in (-1e-9, 1e-9))
        changes.append(float(np.abs(after - before).max() / np.abs(before).max()))
    mirrored = balls.state * [1, -1, 1, -1, -1, 1, -1] + [0, TABLE.width, 0, 0, 0, 0, 0]
    tilted = replace(physics, values=physics.values * np.where(np.arange(len(physics.values)) == SLOPE_Y, -1.0, 1.0))
    image = simulate(replace(balls, state=mirrored), TABLE, tilted, 1.0).states_at(t)[..., :2]
    image = image * [1, -1] + [0, TABLE.width]
    moved = replace(balls, state=balls.state + np.concatenate([TABLE_SHIFT, np.zeros(5)]))
    shifted = simulate(moved, TABLE, physics, 1.0, NOSES_SHIFTED).states_at(t)
    return (
        float(np.diff(joules).max() / joules[0]), max(changes),
        1e3 * float(np.abs(image - run.states_at(t)[..., :2]).max()),
        1e3 * float(np.abs(shifted[..., :2] - TABLE_SHIFT - run.states_at(t)[..., :2]).max()),
    )  # fmt: skip


def print_symmetries(shots: int) -> None:
    print("| cushion | ball | energy grows by | momentum changes by | mirrored, mm | shifted, mm |")
    print("|---|---|---|---|---|---|")
    for laws in product(CUSHION_MODELS, BALL_MODELS):
        rng = np.random.default_rng(11)
        worst = np.max([measure_symmetries(build_physics(*laws), draw_opening(rng)) for _ in range(shots)], axis=0)
        print(f"| {' | '.join(laws)} | {' | '.join(f'{one:.1e}' for one in worst)} |", flush=True)


def simulate_with_world(
    balls: list[BallSet], laws: tuple[str, str], seconds: list[float], folder: Path
) -> list[FloatArray]:
    """Simulate every shot with worlds/billiards.py; returns positions (T, 4, 2) m at `HZ`."""
    arguments, names = [], ("x", "y", "vx", "vy", "wx", "wy", "wz")
    for number, (one, last) in enumerate(zip(balls, seconds, strict=True)):
        ball_rows = [
            {"id": name, **dict(zip(names, map(float, row), strict=True)), "radius": RADIUS, "mass": MASS}
            for name, row in zip(one.ids, one.state, strict=True)
        ]
        shot = {
            "table": {"length": TABLE.length, "width": TABLE.width, "pockets": False}, "seconds": last, "hz": HZ,
            "balls": ball_rows, "effects": EFFECTS, "laws": dict(zip(("cushion", "ball"), laws, strict=True)),
        }  # fmt: skip
        out = folder / str(number)
        out.mkdir(parents=True, exist_ok=True)
        (out / "shot.json").write_text(json.dumps(shot))
        arguments += [str(out / "shot.json"), str(out)]
    subprocess.run([sys.executable, str(WORLD), *arguments], check=True)
    return [_read_positions(folder / str(number)) for number in range(len(balls))]


def _read_positions(folder: Path) -> FloatArray:
    with (folder / "trajectory.csv").open() as file:
        rows = [(float(row["x"]), float(row["y"])) for row in csv.DictReader(file)]
    return np.array(rows).reshape(-1, 4, 2)


def measure_world_shots(laws: tuple[str, str], shots: int) -> list[float]:
    """Return the largest distance of any ball from the other simulator, mm, of every shot."""
    rng = np.random.default_rng(7)
    balls = [draw_opening(rng) for _ in range(shots)]
    runs = [simulate(one, TABLE, build_physics(*laws), 4.0) for one in balls]
    ends = [min(r.contacts[1, EVENT_TIME] + AFTER_SECOND_CONTACT if len(r.contacts) > 1 else 3.3, 4.0) for r in runs]
    with tempfile.TemporaryDirectory() as folder:
        there = simulate_with_world(balls, laws, ends, Path(folder))
    return [
        1e3 * float(np.linalg.norm(places - run.states_at(np.arange(len(places)) / HZ)[..., :2], axis=-1).max())
        for places, run in zip(there, runs, strict=True)
    ]


def print_world_shots(shots: int) -> None:
    print("\n| cushion | ball | shots | median mm | worst mm (goal 1) |\n|---|---|---|---|---|")
    for laws in SHARED_MODELS:
        apart = measure_world_shots(laws, shots)
        print(f"| {' | '.join(laws)} | {shots} | {np.median(apart):.3f} | {max(apart):.3f} |", flush=True)


def measure_break(balls: BallSet, table: Table, physics: Physics) -> tuple[float, int, int]:
    """Return CPU ms, number of contacts and number of events of a shot of 10 s."""
    begun = time.process_time()
    run = simulate(balls, table, physics, 10.0)
    return 1e3 * (time.process_time() - begun), len(run.contacts), len(run.events)


def print_breaks(breaks: int) -> None:
    print("\n| cushion model | table | breaks | contacts, median | events, median | CPU ms, median | worst (goal 15) |")
    print("|---|---|---|---|---|---|---|")
    tables = {"level": (POOL, True), "level, no pockets": (replace(POOL, pockets=False), True), "tilted": (POOL, False)}
    for cushion, (name, (table, level)) in product(CUSHION_MODELS, tables.items()):
        physics = build_physics(cushion, "inelastic", level)
        simulate(draw_rack(0), table, physics, 10.0)
        costs, contacts, events = np.array(
            [measure_break(draw_rack(seed), table, physics) for seed in range(1, breaks + 1)]
        ).T
        print(f"| {cushion} | {name} | {breaks} | {np.median(contacts):.0f} | {np.median(events):.0f} "
              f"| {np.median(costs):.1f} | {max(costs):.1f} |", flush=True)  # fmt: skip
    print(f"\nfirst break of a fresh process, compiled code taken from disk: {measure_fresh_break():.0f} CPU ms")


def measure_fresh_break() -> float:
    """Return the CPU ms of the first break of a fresh process, whose compiled code comes from disk."""
    fresh = subprocess.run([sys.executable, "-c", FRESH_BREAK], check=True, capture_output=True, text=True, cwd=ROOT)
    return float(fresh.stdout)


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    rng, sound, tried = np.random.default_rng(11), 0, 0
    for laws in product(CUSHION_MODELS, BALL_MODELS):
        growth, momentum, mirrored, shifted = measure_symmetries(build_physics(*laws), draw_opening(rng))
        sound += max(growth, momentum) < CONSERVED and max(mirrored, shifted) < SYMMETRIC_MM
        tried += 1
    figures = [estimate_share("pairs of models that keep all laws and symmetries", sound, tried)]
    figures += [
        estimate_median(f"{' and '.join(laws)}: distance", measure_world_shots(laws, QUICK_SHOTS), "mm")
        for laws in SHARED_MODELS
    ]
    for name, level in (("level", True), ("sloping", False)):
        physics = build_physics("mathavan_2010", "inelastic", level)
        simulate(draw_rack(0), POOL, physics, 10.0)
        costs = [measure_break(draw_rack(seed), POOL, physics)[0] for seed in range(1, QUICK_BREAKS + 1)]
        figures.append(state_cost(f"nine-ball break, {name} table", float(np.median(costs)), "CPU ms", QUICK_BREAKS))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shots", type=int, default=20, help="shots per pair of contact models")
    parser.add_argument("--breaks", type=int, default=20, help="breaks per cushion model")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = (
            f"{QUICK_SHOTS} shots per pair of models, seed 7; a shot of each pair, seed 11; breaks 1 to {QUICK_BREAKS}"
        )
        run_quick("physics.engine", measure_figures, inputs, alone=True)
        return
    print_symmetries(arguments.shots)
    print_world_shots(arguments.shots)
    print_breaks(arguments.breaks)


if __name__ == "__main__":
    main()
