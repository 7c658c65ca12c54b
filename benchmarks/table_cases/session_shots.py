"""Sessions on a table of the independent simulator worlds/billiards.py: shots of one spinning ball, as noisy tracks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.csv

from benchmarks.fitting.ball_pairs import LENGTH, PX_PER_M, WIDTH, R, overhead_scene
from models.core.scene import Scene
from models.core.tracks import Tracks

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
# Frames and samples per second, m of noise per axis, s before a shot.
FPS, HZ, NOISE_M, LEAD_S = 50, 1000, 5e-4, 0.2
Effects = dict[str, dict[str, float]]


def draw_table(rng: np.random.Generator) -> tuple[Effects, str]:
    """Draw the effects of a table and the contact model of its cushions."""
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)},
        "rolling_resistance": {"mu": rng.uniform(0.007, 0.012)},
        "spin_decay": {"rate": rng.uniform(6.0, 12.0)},
        "cushion_restitution": {"e": rng.uniform(0.78, 0.9)},
        "cushion_friction": {"mu": rng.uniform(0.12, 0.22)},
        "ball_restitution": {"e": 0.95},
        "slope": {"slope_x": rng.uniform(-1.0, 1.0), "slope_y": rng.uniform(-1.0, 1.0)},
    }
    return effects, str(rng.choice(["mirror", "mathavan_2010"]))


def play_session(
    rng: np.random.Generator,
    effects: Effects,
    law: str,
    folder: Path,
    shots: int,
    speeds: tuple[float, float] = (2.0, 3.5),
    seconds: float = 6.0,
) -> list[tuple[Tracks, Scene]]:
    """Play and film a session.

    Args:
        rng: Source of randomness.
        effects: The table.
        law: Contact model of its cushions.
        folder: Folder of the simulator's files.
        shots: Number of shots.
        speeds: Range of the speeds after the strike, m/s.
        seconds: Length of a shot.

    Returns:
        Tracks and scene of each shot.
    """
    words: list[str] = []
    for number in range(shots):
        out = folder / f"shot_{number}"
        out.mkdir(parents=True, exist_ok=True)
        shot = _draw_shot(rng, effects, law, speeds) | {"seconds": seconds}
        (out / "shot.json").write_text(json.dumps(shot))
        words += [str(out / "shot.json"), str(out)]
    subprocess.run([sys.executable, str(WORLD), *words], check=True)
    return [_film_shot(rng, Path(out)) for out in words[1::2]]


def _draw_shot(rng: np.random.Generator, effects: Effects, law: str, speeds: tuple[float, float]) -> dict[str, object]:
    """Draw a ball in any direction, with side spin."""
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(*speeds)
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    roll = rng.uniform(0.2, 1.0)
    ball = {
        "id": "white", "x": rng.uniform(0.4, LENGTH - 0.4), "y": rng.uniform(0.3, WIDTH - 0.3), "radius": R,
        "vx": v[0], "vy": v[1], "wx": -roll * v[1] / R, "wy": roll * v[0] / R, "wz": rng.uniform(-0.5, 0.5) * speed / R,
    }  # fmt: skip
    table = {"length": LENGTH, "width": WIDTH, "pockets": False}
    laws = {"cushion": law, "ball": "inelastic"}
    return {"scene": "billiards", "table": table, "hz": HZ, "balls": [ball], "effects": effects,
            "laws": laws}  # fmt: skip


def _film_shot(rng: np.random.Generator, folder: Path) -> tuple[Tracks, Scene]:
    """Observe a shot from straight above, with a lead before the strike."""
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    xy = np.stack([rows[name].to_numpy() for name in "xy"], axis=1)
    whole = np.concatenate([np.repeat(xy[:1], round(LEAD_S * HZ), axis=0), xy])[:: HZ // FPS, None]
    measured = whole + rng.normal(0, NOISE_M, whole.shape)
    shape, t = measured.shape[:2], np.arange(len(whole)) / FPS
    sigma = np.full(shape, NOISE_M)
    tracks = Tracks(
        np.arange(len(t)), t, ("white",), ("white",), measured, measured * PX_PER_M + 30, sigma, sigma,
        np.zeros_like(measured), np.full(shape, R * PX_PER_M), np.array([[90.0, 0.0, 5.0]]),
    )  # fmt: skip
    return tracks, overhead_scene()
