"""Particles from a tracks.csv that says no more than where they were, and motions of them as files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.estimation.particles.body_names import named_bodies
from models.estimation.particles.particle_fit import Explained, Particles
from models.estimation.particles.particle_prediction import Foretold
from pipeline.io.run_folder import Columns, read_table
from pipeline.io.run_tables import write_columns

AXES = ("x", "y", "z")
SCENES = ("billiards", "flight", "pendulum", "slide")
"""Of track folders: what else stands in scene.json, or nothing, is particles."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Particles of one shot of a file, by name."""

    number: int
    ids: tuple[str, ...]
    axes: tuple[str, ...]
    particles: Particles


def tracks_file(source: Path) -> Path:
    """The tracks.csv of a folder, or the file itself. OptionError where it is missing."""
    path = source / "tracks.csv" if source.is_dir() else source
    if not path.is_file():
        raise OptionError(f"A tracks.csv or a folder with one was expected; there is no {path}")
    return path


def is_particles(source: Path) -> bool:
    """Whether nothing beside a tracks.csv says that it is one of the scenes that are known by name."""
    path = source / "tracks.csv" if source.is_dir() else source
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    alone = not (path.parent / "scene.json").is_file()
    return alone or _told(path).get("scene", SCENES[0]) not in SCENES


def _told(path: Path) -> dict[str, Any]:
    """What scene.json beside a file says, nothing where there is none."""
    beside = path.parent / "scene.json"
    if not beside.is_file():
        return {}
    try:
        told = json.loads(beside.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OptionError(f"{beside} is no JSON: {error}") from error
    if not isinstance(told, dict):
        raise OptionError(f"{beside} describes no scene")
    return told


def read_particles(path: Path, fps: float | None = None) -> Iterator[Shot]:
    """The shots of a file with the columns id, x, y (z), and t or frame; rows may be missing."""
    columns = read_table(path, ("id", "x", "y"))
    axes = tuple(axis for axis in AXES if axis in columns)
    columns["t"] = _times(columns, path, fps)
    columns["shot"] = np.nan_to_num(columns.get("shot", np.zeros(len(columns["id"])))).astype(np.int64)
    there = np.isfinite(columns["t"]) & (columns.get("observed", np.ones(len(columns["t"]))) > 0)
    for axis in axes:
        there &= np.isfinite(columns[axis])
    if not there.any():
        raise OptionError(f"{path} holds no place of a particle")
    for number in dict.fromkeys(columns["shot"][there].tolist()):
        rows = there & (columns["shot"] == number)
        yield _shot(number, axes, {name: values[rows] for name, values in columns.items()}, path)


def _times(columns: Columns, path: Path, fps: float | None) -> FloatArray:
    """s of every row; t wins over fps."""
    if "t" in columns:
        return np.asarray(columns["t"], np.float64)
    told = fps if fps is not None else _told(path).get("fps")
    if "frame" not in columns or not isinstance(told, int | float) or told <= 0:
        raise OptionError(f"{path} says no time: it needs the column t, or frame and --fps")
    return np.asarray(columns["frame"] / told, np.float64)


def _shot(number: int, axes: tuple[str, ...], columns: Columns, path: Path) -> Shot:
    t, row = np.unique(columns["t"], return_inverse=True)
    ids = tuple(dict.fromkeys(columns["id"].tolist()))
    index = {name: k for k, name in enumerate(ids)}
    x = np.full((len(t), len(ids), len(axes)), np.nan)
    x[row, [index[name] for name in columns["id"].tolist()]] = np.stack([columns[axis] for axis in axes], axis=1)
    try:
        particles = Particles(t, x, named_bodies(ids, x))
    except ValueError as error:
        raise OptionError(f"{path}, shot {number}: {error}") from error
    return Shot(number, ids, axes, particles)


def physics(found: Explained | Foretold) -> dict[str, Any]:
    """What was found of the physics behind particles, for --json: a sigma that is not finite is None."""
    known = {name: sigma if np.isfinite(sigma) else None for name, sigma in found.errors.items()}
    return {"numbers": found.numbers, "numbers_sigma": known, "not_told": list(found.untold)}


def described(told: dict[str, Any]) -> Iterator[str]:
    """Lines that say what `physics` holds."""
    for name, value in told["numbers"].items():
        sigma = told["numbers_sigma"].get(name)
        yield f"  {name} {value:.5g}{'' if sigma is None else f' ± {sigma:.2g}'}"
    yield from (f"  {sentence}" for sentence in told["not_told"])


def write_places(path: Path, shots: list[Shot], rows: list[dict[str, FloatArray]]) -> None:
    """One table of several shots: rows of each are t (M,), x (M, N, D), sigma (M, N) and more of (M, N); a place that
    is not finite has no row."""
    parts = [_columns(shot, values) for shot, values in zip(shots, rows, strict=True)]
    write_columns({name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, path)


def _columns(shot: Shot, values: dict[str, FloatArray]) -> Columns:
    x = values["x"]
    row, k = np.nonzero(np.isfinite(x).all(axis=2))
    columns: Columns = {"shot": np.full(len(row), shot.number), "frame": row, "t": values["t"][row],
                        "id": np.array(shot.ids)[k]}  # fmt: skip
    columns |= {axis: x[row, k, number] for number, axis in enumerate(shot.axes)}
    columns |= {name: given[row, k] for name, given in values.items() if name not in ("t", "x")}
    if "observed" in columns:
        columns["observed"] = columns["observed"].astype(np.int64)
    return columns
