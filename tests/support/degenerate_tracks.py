"""Track folders of every scene, whole or spoilt in the ways in which trackers and exports spoil them."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Columns = dict[str, np.ndarray]
COORDINATES = {"slide": ("x", "y"), "flight": ("x", "z"), "pendulum": ("theta1",), "billiards": ("x", "y")}
FPS, FRAMES, SHOTS = 60.0, 30, 3
NOISE = 5e-4
SCENES: dict[str, dict[str, Any]] = {
    "slide": {"scene": "slide", "units": "m"},
    "flight": {"scene": "flight", "units": "m"},
    "pendulum": {"scene": "pendulum", "units": "rad"},
    "billiards": {
        "scene": "billiards", "units": "m", "fps": FPS, "ball_radius": 0.03, "table": {"length": 2.5, "width": 1.25},
        "model": ["rolling_resistance", "cushion_restitution"],
    },
}  # fmt: skip


def make_tracks(scene: str, rng: np.random.Generator, shots: int = SHOTS) -> Columns:
    """Make plain motion with noise: friction on a plane, a parabola, a swing, or a ball that meets a cushion."""
    t = np.arange(FRAMES) / FPS
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("shot", "frame", "t", "id", *COORDINATES[scene])}
    for shot in range(shots):
        speed, angle = rng.uniform(1.0, 2.0), rng.uniform(-1.0, 1.0)
        paths = {"a": _follow_path(scene, t, speed, angle)}
        if scene == "billiards":
            paths["b"] = np.repeat([[2.2, 0.2]], FRAMES, axis=0)
        for name, path in paths.items():
            noisy = path + NOISE * rng.standard_normal(path.shape)
            for column, values in zip(
                rows,
                (np.full(FRAMES, shot), np.arange(FRAMES), t, np.full(FRAMES, name), *noisy.T),
                strict=True,
            ):
                rows[column].append(values)
    return {name: np.concatenate(parts) for name, parts in rows.items()}


def _follow_path(scene: str, t: np.ndarray, speed: float, angle: float) -> np.ndarray:
    """Return positions (T, D) of one body."""
    if scene == "pendulum":
        return (0.5 * speed * np.cos(6.0 * t) * np.exp(-0.1 * t))[:, None]
    way = speed * t - 0.5 * 0.3 * t**2
    if scene == "flight":
        return np.stack([way * np.cos(angle), speed * t - 0.5 * 9.81 * t**2], axis=1)
    x = 1.25 + way * np.cos(angle)
    y = 0.6 + way * np.sin(angle)
    return np.stack([1.25 + np.abs(x - 1.25), np.abs(y)], axis=1) if scene == "billiards" else np.stack([x, y], axis=1)


def _scale_places(factor: float) -> Callable[[str, Columns, np.random.Generator], None]:
    def spoil(scene: str, columns: Columns, rng: np.random.Generator) -> None:
        for name in COORDINATES[scene]:
            columns[name] = columns[name] * factor

    return spoil


def _scale_times(factor: float) -> Callable[[str, Columns, np.random.Generator], None]:
    def spoil(scene: str, columns: Columns, rng: np.random.Generator) -> None:
        columns["t"] = columns["t"] * factor

    return spoil


def _repeat_times(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["t"][5] = columns["t"][4]


def _reverse_times(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["t"] = -columns["t"]


def _keep_one_sample(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in columns:
        columns[name] = columns[name][:1]


def _keep_one_shot(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    chosen = columns["shot"] == 0
    for name in columns:
        columns[name] = columns[name][chosen]


def _remove_most_rows(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    chosen = rng.uniform(size=len(columns["t"])) < 0.2
    for name in columns:
        columns[name] = columns[name][chosen]


def _empty_a_shot(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][columns["shot"] == 1] = np.nan


def _lose_places(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][rng.uniform(size=len(columns[name])) < 0.3] = np.nan


def _lose_all_places(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][:] = np.nan


def _lose_times(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["t"][3:6] = np.nan


def _overflow_places(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns[COORDINATES[scene][0]][7] = np.inf
    columns[COORDINATES[scene][0]][9] = 1e300


def _stop_motion(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][:] = 0.5


def _remove_noise(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][:] = np.round(columns[name], 2)


def _jump_wildly(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    for name in COORDINATES[scene]:
        columns[name][:] = rng.uniform(0.0, 1.2, len(columns[name]))


def _name_alike(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["id"] = np.full(len(columns["id"]), "a")
    columns["frame"] = np.repeat(columns["frame"][::2], 2)[: len(columns["frame"])]


def _state_sigmas(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["sigma"] = rng.choice([0.0, np.nan, np.inf, 1e-300, 1e300, 1e-3], len(columns["t"]))


def _speed_up(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    """Make bodies forty times as fast; balls bounce off the edges of the table."""
    for name, side in zip(COORDINATES[scene], (2.5, 1.25), strict=False):
        far = columns[name][0] + 40.0 * (columns[name] - columns[name][0])
        columns[name] = np.abs((far + side) % (2 * side) - side) if scene == "billiards" else far


def _film_fast(scene: str, columns: Columns, rng: np.random.Generator) -> None:
    columns["t"] = columns["t"] / 500.0
    columns["frame"] = columns["frame"] * 3


SPOILERS: dict[str, Callable[[str, Columns, np.random.Generator], None]] = {
    "places times 1e-6": _scale_places(1e-6),
    "places times 1e6": _scale_places(1e6),
    "times times 1e-6": _scale_times(1e-6),
    "times times 1e6": _scale_times(1e6),
    "equal times": _repeat_times,
    "decreasing times": _reverse_times,
    "one sample": _keep_one_sample,
    "one shot": _keep_one_shot,
    "few rows": _remove_most_rows,
    "an empty shot": _empty_a_shot,
    "missing places": _lose_places,
    "no places": _lose_all_places,
    "missing times": _lose_times,
    "infinite places": _overflow_places,
    "constant places": _stop_motion,
    "rounded places": _remove_noise,
    "noise alone": _jump_wildly,
    "two bodies of one name": _name_alike,
    "impossible sigmas": _state_sigmas,
    "wild motion": _speed_up,
    "30000 frames per second": _film_fast,
}
"""Ways to spoil the columns of a track folder in place."""


def write_track_folder(folder: Path, scene: str, columns: Columns) -> Path:
    """Write tracks.csv and scene.json."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "tracks.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*columns.values(), strict=True))
    (folder / "scene.json").write_text(json.dumps(SCENES[scene]))
    return folder
