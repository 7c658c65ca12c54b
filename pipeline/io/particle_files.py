"""Tracks of particles without a known scene, read from a tracks.csv, and files of their fitted motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.core.errors import OptionError
from models.core.recording import Recording, record_points
from models.core.typing import FloatArray
from pipeline.io.csv_tables import write_columns
from pipeline.io.row_grid import build_row_grid
from pipeline.io.strict_json import read_json
from pipeline.io.text_table import Columns, read_text_table
from pipeline.io.track_conventions import TrackRows, TrackScene, interpret_tracks

if TYPE_CHECKING:
    from models.estimation.particles.particle_fit import ParticleMotion, ParticlePrediction

AXES = ("x", "y", "z")
# Scenes of track folders; tracks with any other scene, or none, are particles.
NAMED_SCENES = ("billiards", "flight", "pendulum", "slide")


def is_particle_source(source: Path) -> bool:
    """Return whether a source is a tracks.csv without a named scene.

    Args:
        source: A folder or a file.

    Returns:
        True if there is no scene.json beside the tracks.csv, or it has another scene than `NAMED_SCENES`.
    """
    path = source / "tracks.csv" if source.is_dir() else source
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    alone = not (path.parent / "scene.json").is_file()
    return alone or _read_scene_document(path).get("scene", NAMED_SCENES[0]) not in NAMED_SCENES


def _read_scene_document(path: Path) -> dict[str, Any]:
    """Read the scene.json beside a file; empty if there is none."""
    beside = path.parent / "scene.json"
    if not beside.is_file():
        return {}
    document = read_json(beside, "The scene of the particles was expected")
    if not isinstance(document, dict):
        raise OptionError(f"{beside} describes no scene")
    return document


def read_particles(path: Path, fps: float | None = None) -> tuple[list[Recording], tuple[str, ...]]:
    """Read the shots of a file with the columns id, x, y (z), and t or frame; rows may be missing.

    Args:
        path: A tracks.csv.
        fps: Frame rate (1/s) for files without the column t; None for the rate of scene.json.

    Returns:
        The shots in the order of the file, and sentences on what was assumed.

    Raises:
        OptionError: The file cannot be used.
    """
    table = read_text_table(path)
    table.require(("x", "y"))
    rate = fps if fps is not None else _read_scene_document(path).get("fps")
    rate = float(rate) if isinstance(rate, int | float) and rate > 0 else None
    rows = interpret_tracks(table, TrackScene(coordinates=AXES, fps=rate))
    if not rows.is_usable.any():
        raise OptionError(f"{path} has no position of a particle")
    numbers = dict.fromkeys(rows.shot[rows.is_usable].tolist())
    return [_build_recording(number, rows, path) for number in numbers], rows.notes


def _build_recording(number: int, rows: TrackRows, path: Path) -> Recording:
    here = np.flatnonzero(rows.is_usable & (rows.shot == number))
    grid = build_row_grid(rows.t[here], rows.ids[here])
    from models.estimation.particles.particle_fit import MIN_SAMPLES  # slow to import

    particles = record_points(rows.t[here][grid.first], grid.scatter(rows.positions[here]), grid.bodies, number)
    try:
        particles.require_samples(MIN_SAMPLES)
    except ValueError as error:
        raise OptionError(f"{path}, shot {number}: {error}") from error
    return particles


def summarize_physics(result: ParticleMotion | ParticlePrediction) -> dict[str, Any]:
    """Summarize the fitted physics of particles for --json.

    Args:
        result: Fitted motion or prediction.

    Returns:
        Parameters, their standard deviations (None if not finite), and sentences on what is not identifiable.
    """
    sigmas = {name: sigma if np.isfinite(sigma) else None for name, sigma in result.parameter_sigma.items()}
    return {"numbers": result.parameters, "numbers_sigma": sigmas, "not_told": list(result.not_identifiable)}


def format_physics_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Format a summary of the fitted physics for the terminal.

    Args:
        summary: Result of `summarize_physics`.

    Yields:
        One line per parameter and per sentence.
    """
    for name, value in summary["numbers"].items():
        sigma = summary["numbers_sigma"].get(name)
        yield f"  {name} {value:.5g}{'' if sigma is None else f' ± {sigma:.2g}'}"
    yield from (f"  {sentence}" for sentence in summary["not_told"])


def write_particle_positions(path: Path, shots: list[Recording], rows: list[dict[str, FloatArray]]) -> None:
    """Write positions of particles of several shots as one table; positions that are not finite have no row.

    Args:
        path: File to write.
        rows: Per shot: t (M,) s, x (M, N, D), sigma (M, N) and further columns (M, N).
    """
    parts = [_build_columns(shot, values) for shot, values in zip(shots, rows, strict=True)]
    write_columns({name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, path)


def _build_columns(shot: Recording, values: dict[str, FloatArray]) -> Columns:
    x = values["x"]
    row, k = np.nonzero(np.isfinite(x).all(axis=2))
    columns: Columns = {"shot": np.full(len(row), shot.shot), "frame": row, "t": values["t"][row],
                        "id": np.array(shot.bodies)[k]}  # fmt: skip
    columns |= {axis: x[row, k, number] for number, axis in enumerate(shot.reference.coordinates)}
    columns |= {name: column[row, k] for name, column in values.items() if name not in ("t", "x")}
    if "observed" in columns:
        columns["observed"] = columns["observed"].astype(np.int64)
    return columns
