"""Random shots of an engine that shares no code with the program, filmed to detections."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv

from benchmarks.stress_cases.shot_truth import ShotTruth, TruePaths, make_engine_truth
from benchmarks.stress_cases.stress_chain import Recording
from benchmarks.tracking.break_shots import HZ, LENGTH, PX_PER_M, REST, WIDTH, WORLD, R, overhead_scene
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import FloatArray, IntArray

# Simulated time, s.
SECONDS = 4.0
CAROM_RADIUS = 0.03075
# Three balls of carom; two to five balls without pockets; four to eight with pockets; a power shot of either.
KINDS = ("carom", "open", "pool", "power")
# CIE L*a*b* colour, white share and HSV value by look.
LOOKS: dict[str, tuple[tuple[float, float, float], float, float]] = {
    "cue": ((88, 0, 6), 0.95, 0.95), "yellow": ((78, 5, 65), 0.1, 0.95), "red": ((42, 55, 35), 0.1, 0.7),
    "blue": ((35, 5, -45), 0.1, 0.7), "purple": ((35, 30, -30), 0.1, 0.5), "orange": ((62, 40, 55), 0.1, 0.9),
    "green": ((45, -40, 15), 0.1, 0.55), "maroon": ((30, 30, 15), 0.1, 0.45), "eight": ((15, 0, 0), 0.08, 0.12),
}  # fmt: skip
# Share of missed detections.
MISSED = 0.02
# Error of a centre along its streak over the length of the streak.
STREAK_SIGMA = 0.08


@dataclass(frozen=True, slots=True)
class DrawnShot:
    """A shot as the engine reads it, with what the camera needs."""

    name: str
    kind: str
    pockets: bool
    fps: float
    exposure: float
    """Share of a frame."""
    noise_px: float
    content: dict[str, Any]

    @property
    def radius(self) -> float:
        """Radius of the balls, m."""
        return CAROM_RADIUS if self.kind == "carom" else R


def draw_synthetic_shot(seed: int, number: int) -> DrawnShot:
    """Draw shot `number` of a seed.

    Args:
        seed: Seed of the run.
        number: Number of the shot, from 0; it also decides on the kind.

    Returns:
        The shot.
    """
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    pockets = kind == "pool" or (kind == "power" and bool(rng.integers(2)))
    count = {"carom": 3, "open": int(rng.integers(2, 6)), "pool": int(rng.integers(4, 9))}.get(kind)
    count = count or int(rng.integers(2, 9))
    radius = CAROM_RADIUS if kind == "carom" else R
    places = _draw_places(count, rng)
    aim = places[1] - places[0]
    if rng.random() < 0.2:  # at a cushion first
        aim = rng.normal(size=2)
    angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-2.2, 2.2) * radius / np.hypot(*(places[1] - places[0]))
    speed = rng.uniform(4.5, 8.0) if kind == "power" else rng.uniform(1.0, 4.0)
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    roll, side = rng.uniform(-0.3, 1.0), rng.uniform(-0.6, 0.6) * speed / radius
    balls = [{"id": str(k), "x": x, "y": y, "radius": radius} for k, (x, y) in enumerate(places.tolist())]
    spin = {"vx": v[0], "vy": v[1], "wx": -roll * v[1] / radius, "wy": roll * v[0] / radius, "wz": side}
    balls[0] |= {name: float(value) for name, value in spin.items()}
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)}, "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": 10.0}, "cushion_restitution": {"e": rng.uniform(0.75, 0.92)},
        "cushion_friction": {"mu": rng.uniform(0.1, 0.25)}, "ball_restitution": {"e": rng.uniform(0.92, 0.98)},
    }  # fmt: skip
    laws = {
        "cushion": ["mirror", "mathavan_2010"][int(rng.integers(2))],
        "ball": ["inelastic", "alciatore"][number % 2],
    }
    table = {"length": LENGTH, "width": WIDTH, "pockets": pockets}
    content = {"scene": "billiards", "table": table, "seconds": SECONDS, "hz": HZ, "balls": balls, "effects": effects,
               "laws": laws}  # fmt: skip
    fps = float(rng.choice([15, 25, 30, 60]))
    name = f"{kind}_{seed}_{number}_{fps:g}fps"
    return DrawnShot(name, kind, pockets, fps, rng.uniform(0.15, 0.6), rng.uniform(0.4, 1.2), content)


def simulate_shots(shots: list[DrawnShot], folder: Path) -> None:
    """Simulate the shots that have no folder yet, all in one process of the engine.

    Args:
        folder: Folder of the results.
    """
    arguments: list[str] = []
    for shot in shots:
        out, text = folder / shot.name, json.dumps(shot.content)
        source = out / "shot.json"
        if (out / "events.csv").is_file() and source.read_text() == text:
            continue
        out.mkdir(parents=True, exist_ok=True)
        source.write_text(text)
        arguments += [str(source), str(out)]
    if arguments:
        subprocess.run([sys.executable, str(WORLD), *arguments], check=True)


def film_synthetic_shot(shot: DrawnShot, folder: Path, seed: int) -> tuple[Recording, ShotTruth]:
    """Film a simulated shot: noise, streaks, missed detections.

    Args:
        folder: Folder of `simulate_shots`.
        seed: Seed of the noise.

    Returns:
        Detections and truth.
    """
    rng = np.random.default_rng([seed, 1])
    xyz = _read_path(folder / shot.name, len(shot.content["balls"]))
    frame = np.arange(int((REST + SECONDS) * shot.fps))
    t: FloatArray = ((frame + rng.uniform(0, 1)) / shot.fps).astype(np.float64)
    begin, middle, end = (
        _sample_path(xyz, t + share * shot.exposure / shot.fps, shot.radius) for share in (-0.5, 0.0, 0.5)
    )
    centre = (begin + 2 * middle + end) / 4
    scene = _make_scene(shot)
    seen = np.isfinite(centre[..., 0]) & (rng.random(centre.shape[:2]) > MISSED)
    row, ball = np.nonzero(seen)
    to_pixels = scene.camera.to_pixels
    px = to_pixels(centre[row, ball], shot.radius)
    streak = to_pixels(end[row, ball], shot.radius) - to_pixels(begin[row, ball], shot.radius)
    detections = _make_detections(shot, row, ball, px, streak, rng)
    truth_rows = _read_events(folder / shot.name)
    paths = TruePaths(frame.astype(float), tuple(b["id"] for b in shot.content["balls"]), middle)
    return Recording(detections, frame, t - t[0], scene), make_engine_truth(truth_rows, t, paths, shot.radius)


def _draw_places(count: int, rng: np.random.Generator) -> FloatArray:
    while True:
        places = rng.uniform([0.1, 0.1], [LENGTH - 0.1, WIDTH - 0.1], (count, 2))
        apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(count)
        if apart.min() > 0.12 and apart[0, 1] > 0.3:
            return np.asarray(places)


def _make_scene(shot: DrawnShot) -> Scene:
    scene = overhead_scene(shot.pockets)
    if shot.kind != "carom":
        return scene
    return replace(scene, table=replace(scene.table, name="carom", game="carom", ball_radius=CAROM_RADIUS))


def _make_detections(
    shot: DrawnShot, row: IntArray, ball: IntArray, px: FloatArray, streak: FloatArray, rng: np.random.Generator
) -> Detections:
    """Make detections with errors along and across the streak, and the look of each ball."""
    names = ["cue", "yellow", "red"] if shot.kind == "carom" else ["cue", *[n for n in LOOKS if n != "cue"]]
    looks = [LOOKS[names[k % len(names)]] for k in range(len(shot.content["balls"]))]
    length = np.linalg.norm(streak, axis=1)
    streak = np.where(length[:, None] > 1.0, streak, 0.0)
    sigma = np.full(len(row), shot.noise_px)
    along = np.hypot(sigma, STREAK_SIGMA * np.where(length > 1.0, length, 0.0))
    direction = np.where(length[:, None] > 1.0, streak / np.maximum(length[:, None], 1e-9), [1.0, 0.0])
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    noise = rng.normal(size=(2, len(row), 1)) * np.stack([along, sigma])[..., None]
    colour = np.array([look[0] for look in looks], dtype=float)[ball] + rng.normal(0, 3, (len(row), 3))
    white, value = (np.array([look[k] for look in looks])[ball] for k in (1, 2))
    radius = np.full(len(row), shot.radius * PX_PER_M)
    centre = px + noise[0] * direction + noise[1] * across
    return Detections(row, centre, radius, streak, colour, white, white, value, np.ones(len(row)), sigma, along)


def _sample_path(xyz: FloatArray, t: FloatArray, radius: float) -> FloatArray:
    """Return the places (T, N, 2) m at clip times t (T,); NaN once a ball falls."""
    rows = np.clip(np.round((t - REST) * HZ).astype(int), 0, len(xyz) - 1)
    return np.where(xyz[rows, :, 2:] > 0.9 * radius, xyz[rows, :, :2], np.nan)


def _read_path(folder: Path, balls: int) -> FloatArray:
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    return np.stack([rows[name].to_numpy().reshape(-1, balls) for name in "xyz"], axis=2)


def _read_events(folder: Path) -> list[dict[str, Any]]:
    text = pyarrow.csv.ConvertOptions(column_types={"a": pyarrow.string(), "b": pyarrow.string()})
    rows: list[dict[str, Any]] = pyarrow.csv.read_csv(folder / "events.csv", convert_options=text).to_pylist()
    return [row | {"t": row["t"] + REST} for row in rows]
