"""Predict whether shots that are played otherwise score, and compare with an independent simulator.

    python -m benchmarks.fitting.what_if_check [SHOTS] [FIRST] [--quick] [--plays N] [--out DIR]

The truth is worlds/billiards.py, run as a process: a cue ball aimed so that it pots a ball (even shots, a pool
table), or meets two others (odd shots, carom), on a random table with the ball law `alciatore`. A player of known
spread (2 % of the speed, 0.5 degrees) plays one shot, which is filmed at 60 fps with 1 mm of noise per axis and
fitted. The same player then plays it otherwise: with a random change of speed, direction and spin. The predicted
probability of success is compared with N plays in the simulator. Printed: Brier score over all plays, the score of a
perfect forecast (which knows the simulator's own probability) and of the base rate, and a table of reliability. Rows
are kept in DIR, so that a second call resumes. Takes about fifteen seconds per shot.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv

from benchmarks.fitting.prediction_shots import IDS, LAWS, LEAD, WORLD, film_shot, overhead_scene
from benchmarks.fitting.prediction_shots import SimulatedShot as FilmedShot
from benchmarks.support.figures import Figure, add_quick_option, estimate_statistic, run_quick
from models.core.options import FitOptions
from models.core.scene import Scene
from models.core.typing import FloatArray
from models.estimation.changed_shot import (
    PlayerSpread,
    ShotGoal,
    StrokeChange,
    change_stroke,
    draw_struck_ensemble,
    group_by_ball,
    is_scored,
    play_changed_shot,
)
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws

SPREAD = PlayerSpread(0.02, 0.5)
# s that are simulated and filmed.
SECONDS, FILMED = 8.0, 4.0
LENGTH, WIDTH, R, HZ = 2.54, 1.27, 0.028575, 1000
DRAWS = 300
QUICK_SHOTS, QUICK_PLAYS = range(100, 105), 4
STATE = ("x", "y", "vx", "vy", "wx", "wy", "wz")


def draw_base_shot(number: int) -> tuple[dict[str, Any], ShotGoal]:
    """Draw the shot that the player means to play."""
    rng = np.random.default_rng([36, number])
    pockets = number % 2 == 0
    while True:
        places = rng.uniform([0.2, 0.2], [LENGTH - 0.2, WIDTH - 0.2], (3, 2))
        if min(np.hypot(*(places[a] - places[b])) for a, b in ((0, 1), (0, 2), (1, 2))) < 0.3:
            continue
        if not pockets:
            aim = places[1] - places[0]
            angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-1, 1) * 1.6 * R / np.hypot(*aim)
            break
        target = np.array([(0.0, 0.0), (LENGTH, 0.0), (0.0, WIDTH), (LENGTH, WIDTH)][int(rng.integers(4))])
        line = (target - places[1]) / np.hypot(*(target - places[1]))
        ghost = places[1] - 2 * R * line
        way = ghost - places[0]
        if way @ line > 0.6 * np.hypot(*way) and np.hypot(*(target - places[1])) < 0.9:  # cut below 53 degrees
            angle = np.arctan2(way[1], way[0])
            break
    speed = rng.uniform(1.2, 2.8)
    share, side = rng.uniform(-0.2, 1.0), rng.uniform(-0.4, 0.4)
    state = build_state(places[0], speed, angle, share, side)
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)}, "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": 10.0}, "cushion_restitution": {"e": rng.uniform(0.75, 0.9)},
        "cushion_friction": {"mu": rng.uniform(0.14, 0.22)}, "ball_restitution": {"e": rng.uniform(0.93, 0.97)},
    }  # fmt: skip
    balls: list[dict[str, Any]] = [
        {"id": name, "x": x, "y": y, "radius": R} for name, (x, y) in zip(IDS, places.tolist(), strict=True)
    ]
    balls[0] |= dict(zip(STATE, state.tolist(), strict=True))
    content = {
        "scene": "billiards", "table": {"length": LENGTH, "width": WIDTH, "pockets": pockets}, "seconds": SECONDS,
        "hz": HZ, "balls": balls, "effects": effects,
        "laws": {"cushion": LAWS[int(rng.integers(2))], "ball": "alciatore"},
    }  # fmt: skip
    return content, ShotGoal("pot" if pockets else "carom")


def build_state(place: FloatArray, speed: float, angle: float, share: float, side: float) -> FloatArray:
    """Build the state (7,) of a struck ball from speed (m/s), direction (rad) and shares of spin."""
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    return np.array([*place, *v, -share * v[1] / R, share * v[0] / R, -side * speed / R])


def draw_change(number: int) -> StrokeChange:
    """Draw how the shot is played otherwise; every third one is repeated as it is."""
    rng = np.random.default_rng([37, number])
    if number % 3 == 0:
        return StrokeChange()
    return StrokeChange(
        1 + rng.uniform(-0.15, 0.15), None, rng.normal(0, 0.5), rng.uniform(-0.2, 0.2), None, rng.uniform(-0.3, 0.3)
    )


def simulate_plays(content: dict[str, Any], states: FloatArray, folder: Path) -> list[Path]:
    """Simulate the shot from several states (K, 7) of the cue ball in one process; returns the folders."""
    arguments: list[str] = []
    outs = []
    for k, state in enumerate(states):
        out = folder / f"play_{k}"
        out.mkdir(parents=True, exist_ok=True)
        balls = [{**content["balls"][0], **dict(zip(STATE, state.tolist(), strict=True))}, *content["balls"][1:]]
        (out / "shot.json").write_text(json.dumps({**content, "balls": balls, "hz": HZ if k == 0 else 50}))
        arguments += [str(out / "shot.json"), str(out)]
        outs.append(out)
    subprocess.run([sys.executable, str(WORLD), *arguments], check=True)
    return outs


def read_success(folder: Path, goal: ShotGoal) -> bool:
    """Return whether a simulated play scores."""
    rows = pyarrow.csv.read_csv(folder / "events.csv").to_pylist()
    contacts = group_by_ball(((row["t"], (row["kind"], row["a"], row["b"])) for row in rows), IDS)
    return is_scored(contacts, IDS, 0, goal)


def read_film(folder: Path, number: int) -> FilmedShot:
    """Read a simulated play as a shot to be filmed; a potted ball is NaN from its fall on."""
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    xyz = np.stack([rows[name].to_numpy().reshape(-1, len(IDS)) for name in "xyz"], axis=2)
    xy = np.where(xyz[..., 2:] > 0.9 * R, xyz[..., :2], np.nan)
    whole = np.concatenate([np.repeat(xy[:1], round(LEAD * HZ), axis=0), xy])
    return FilmedShot(str(number), np.arange(len(whole)) / HZ, whole, np.empty(0))


def play_case(number: int, plays: int) -> dict[str, Any] | None:
    """Film, fit and predict one shot, and play it in the simulator; None where no shot was fitted."""
    content, goal = draw_base_shot(number)
    change = draw_change(number)
    rng = np.random.default_rng([38, number])
    base = np.array([content["balls"][0][name] for name in STATE])
    (factor, turn), *others = SPREAD.draw(rng, plays + 1)
    filmed = change_stroke(base, R, StrokeChange(), factor, turn)
    # what is played otherwise scatters about the stroke that was filmed, as `what-if` assumes
    states = [filmed, *(change_stroke(filmed, R, change, f, a) for f, a in others)]
    with tempfile.TemporaryDirectory() as folder:
        outs = simulate_plays(content, np.array(states), Path(folder))
        film = read_film(outs[0], number)
        success = [read_success(out, goal) for out in outs[1:]]
    scene = _make_scene(goal)
    tracks = film_shot(film, FILMED, number)
    explained = explain(tracks, scene)
    fit, solution = view_shot(explained), explained.solution
    if solution is None:
        return None
    fit = replace(fit, laws=fit_shot_laws(fit, tracks, scene.table, FitOptions()))
    ensemble = draw_struck_ensemble(fit, solution, tracks, scene.table, 0, DRAWS, 0)
    played = play_changed_shot(ensemble, change, SPREAD, goal, np.array([0.0, 1.0]), 0)
    return {"number": number, "game": goal.game, "whole": ensemble.is_whole_shot, "changed": number % 3 != 0,
            "predicted": played.probability, "successes": int(np.sum(success)), "plays": plays}  # fmt: skip


def _make_scene(goal: ShotGoal) -> Scene:
    from benchmarks.tracking.break_shots import overhead_scene as pool_scene

    return pool_scene(True) if goal.game == "pot" else overhead_scene()


def print_scores(rows: list[dict[str, Any]]) -> None:
    print("| shots | n | plays | base rate | Brier score | perfect forecast | base rate as forecast |")
    print("|---|---|---|---|---|---|---|")
    for name, own in (
        ("all", rows), ("pot", [r for r in rows if r["game"] == "pot"]),
        ("carom", [r for r in rows if r["game"] != "pot"]),
        ("explained whole", [r for r in rows if r["whole"]]), ("changed", [r for r in rows if r["changed"]]),
    ):  # fmt: skip
        if own:
            print(_format_scores(name, own))
    p = np.array([row["predicted"] for row in rows])
    hits, plays = (np.array([row[name] for row in rows], float) for name in ("successes", "plays"))
    print("\n| predicted | shots | mean prediction | successes |\n|---|---|---|---|")
    for low, high in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.001)):
        inside = (p >= low) & (p < high)
        if inside.any():
            rate = hits[inside].sum() / plays[inside].sum()
            print(f"| {low:.0%} to {min(high, 1):.0%} | {inside.sum()} | {p[inside].mean():.0%} | {rate:.0%} |")


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    rows = [row for row in (play_case(number, QUICK_PLAYS) for number in QUICK_SHOTS) if row is not None]
    cases = np.array([[row[key] for key in ("predicted", "successes", "plays")] for row in rows], float)
    return [
        estimate_statistic("what-if: Brier score", cases, "", lambda x: _brier_score(*x.T)),
        estimate_statistic(
            "base rate as forecast: Brier score", cases, "",
            lambda x: _brier_score(np.full(len(x), x[:, 1].sum() / x[:, 2].sum()), *x.T[1:]),
        ),
    ]  # fmt: skip


def _brier_score(p: FloatArray, hits: FloatArray, plays: FloatArray) -> float:
    return float(np.sum(hits * (1 - p) ** 2 + (plays - hits) * p**2) / plays.sum())


def _format_scores(name: str, rows: list[dict[str, Any]]) -> str:
    p, hits, plays = (np.array([row[key] for row in rows], float) for key in ("predicted", "successes", "plays"))
    rate, base = hits / plays, hits.sum() / plays.sum()
    brier = _brier_score(p, hits, plays)
    unbiased = float(np.sum(plays * rate * (1 - rate) * plays / np.maximum(plays - 1, 1)) / plays.sum())
    return (
        f"| {name} | {len(rows)} | {plays.sum():.0f} | {base:.0%} | {brier:.3f} | {unbiased:.3f}"
        f" | {base * (1 - base):.3f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shots", nargs="?", type=int, default=100, help="number of shots")
    parser.add_argument("first", nargs="?", type=int, default=0, help="first shot")
    parser.add_argument("--plays", type=int, default=10, help="plays of each shot in the simulator")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_what_if",
                        help="folder of the rows")  # fmt: skip
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"shots {QUICK_SHOTS[0]} to {QUICK_SHOTS[-1]}, each played {QUICK_PLAYS} times otherwise"
        run_quick("fitting.what_if_check", measure_figures, inputs)
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "rows.jsonl"
    finished = {row["number"]: row for row in map(json.loads, path.read_text().splitlines())} if path.is_file() else {}
    for number in range(arguments.first, arguments.first + arguments.shots):
        if number not in finished:
            row = play_case(number, arguments.plays)
            if row is None:
                print(f"shot {number} could not be fitted", file=sys.stderr)
                continue
            finished[number] = row
            with path.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(
                f"shot {number}: {row['predicted']:.2f}, {row['successes']} of {row['plays']}",
                file=sys.stderr,
                flush=True,
            )
    print_scores(list(finished.values()))


if __name__ == "__main__":
    main()
