"""Tracks of particles without a known scene, read from a tracks.csv."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.core.errors import OptionError
from models.core.recording import Recording, record_points
from pipeline.io.strict_json import read_json
from pipeline.io.text_table import build_row_grid, read_text_table
from pipeline.io.track_conventions import TrackRows, TrackScene, interpret_tracks

if TYPE_CHECKING:
    pass

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
    from models.estimation.particle_fit import MIN_SAMPLES

    particles = record_points(rows.t[here][grid.first], grid.scatter(rows.positions[here]), grid.bodies, number)
    try:
        particles.require_samples(MIN_SAMPLES)
    except ValueError as error:
        raise OptionError(f"{path}, shot {number}: {error}") from error
    return particles
