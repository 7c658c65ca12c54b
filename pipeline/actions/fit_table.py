"""Learn one table from all shots of run folders and track folders; the fit of each shot is cached, so it resumes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.core.errors import OptionError, TrackError
from models.core.joint_solution import JointSolution
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.estimation.forecast.current_state import MIN_NOISE_SPEED
from models.estimation.reconstruction.capture_times import estimate_capture_times
from models.estimation.reconstruction.fit_shot import fit_with_solution
from models.estimation.table_learning.learn_table import TableLesson, learn_table
from models.numerics.executor import Executor
from models.tracking.track_noise import NOISE_FLOOR_RADII, apply_noise, estimate_noise
from pipeline.engine.cache_key import CacheKey
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import load_value, save_value
from pipeline.io.observed_shot import list_shot_numbers, read_observed_shot
from pipeline.io.run_folder import drop_repeated_clips
from pipeline.io.table_profile import SIZE_TOLERANCE

STAGE = "table-shot"
"""Name of the cached fits."""


@dataclass(frozen=True, slots=True)
class FittedTable:
    """What was learned, the table's size, and the shots that could not be used."""

    lesson: TableLesson
    table: Table
    shot_count: int
    refusals: tuple[str, ...]
    """One sentence per shot that could not be used."""
    fits: tuple[tuple[JointSolution, Tracks], ...] = ()
    """Joint fit and tracks of every shot that was used."""
    names: tuple[str, ...] = ()
    """Folder and number of these shots."""
    sources: tuple[Path, ...] = ()
    """Their folders, each clip once."""


@dataclass(frozen=True, slots=True)
class _ShotFit:
    solution: JointSolution | None


def fit_table_of_shots(
    sources: list[Path], cache: ResultCache, executor: Executor, on_shot: Callable[[int, int], None]
) -> FittedTable:
    """Fit every shot, and learn the table from all of them.

    Args:
        sources: Run folders, track folders, or their tracks.csv.
        cache: Holds the fits of shots.
        executor: Distributes the learning over processes.
        on_shot: Called with the number of fitted shots and that of all.

    Returns:
        The learned table.

    Raises:
        OptionError: No source can be read, or the tables differ.
        TrackError: The shots are too few.
    """
    shots, refusals = _read_shots(sources)
    table = _require_one_table(shots, refusals)
    sources, repetitions = drop_repeated_clips(sources)
    if repetitions:
        shots, refusals = _read_shots(sources)
    refusals = [*repetitions, *refusals]
    fits, names = [], []
    for done, (name, tracks, scene) in enumerate(shots):
        on_shot(done, len(shots))
        try:
            fits.append(prepare_shot(tracks, scene, cache))
            names.append(name)
        except (TrackError, ArithmeticError, ValueError) as error:
            refusals.append(f"{name}: {error}")
    on_shot(len(shots), len(shots))
    if not fits:
        raise TrackError(f"physics could be fitted to none of the shots; {refusals[0]}")
    try:
        lesson = learn_table(fits, table, executor=executor)
    except TrackError as error:
        raise TrackError("; ".join([str(error), *repetitions])) from error
    return FittedTable(lesson, table, len(fits), tuple(refusals), tuple(fits), tuple(names), tuple(sources))


def _read_shots(sources: list[Path]) -> tuple[list[tuple[str, Tracks, Scene]], list[str]]:
    """Read all shots; also return one sentence per source or shot that cannot be read."""
    shots, refusals = [], []
    for source in sources:
        try:
            numbers = list_shot_numbers(source)
        except OptionError as error:
            refusals.append(str(error))
            continue
        for number in numbers:
            try:
                tracks, scene, _ = read_observed_shot(source, number)
            except OptionError as error:
                refusals.append(f"shot {number}: {error}")
            else:
                shots.append((f"{source}, shot {number}", tracks, scene))
    return shots, refusals


def _require_one_table(shots: list[tuple[str, Tracks, Scene]], refusals: list[str]) -> Table:
    """Return the table of all shots."""
    if not shots:
        raise OptionError(refusals[0] if refusals else "no shot was given: the tracks have no rows")
    first = shots[0][2].table
    for name, _, scene in shots:
        sizes = np.array([scene.table.length, scene.table.width, scene.table.ball_radius])
        if np.any(np.abs(sizes / [first.length, first.width, first.ball_radius] - 1) > SIZE_TOLERANCE):
            raise OptionError(
                f"one table is learned at a time; {name} is {sizes[0]:g} x {sizes[1]:g} m, the first one"
                f" {first.length:g} x {first.width:g} m"
            )
    return first


def prepare_shot(tracks: Tracks, scene: Scene, cache: ResultCache) -> tuple[JointSolution, Tracks]:
    """Fit a shot, and give its tracks capture times and realistic sigmas, as `learn_table` needs them.

    Args:
        tracks: Tracks of the shot, at presentation times.
        scene: Its table and camera.
        cache: Holds the fits.

    Returns:
        Joint fit and tracks, both at capture times.

    Raises:
        TrackError: Physics could not be fitted.
    """
    solution = fit_cached_shot(tracks, scene, cache)
    if solution is None:
        raise TrackError("physics could not be fitted")
    radius = scene.table.ball_radius
    clock = estimate_capture_times(tracks, NOISE_FLOOR_RADII * radius)
    at_capture = replace(tracks, t=clock.capture_time)
    return solution, apply_noise(at_capture, estimate_noise(at_capture, MIN_NOISE_SPEED, radius))


def hash_shot(tracks: Tracks, scene: Scene) -> str:
    """Hash what the fit of a shot depends on.

    Args:
        tracks: Tracks of the shot.
        scene: Its table and camera.

    Returns:
        SHA-256 as hexadecimal digits.
    """
    digest = hashlib.sha256(repr((tracks.ids, tracks.kinds, scene.table)).encode())
    positions = tracks.xy, tracks.sigma, tracks.sigma_along, tracks.streak
    for array in (tracks.frame, tracks.t, *positions, scene.camera.matrix):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def fit_cached_shot(tracks: Tracks, scene: Scene, cache: ResultCache) -> JointSolution | None:
    """Fit one shot, or read the cached fit.

    Args:
        tracks: Tracks of the shot.
        scene: Its table and camera.
        cache: Holds the fits.

    Returns:
        The joint fit; None where physics could not be fitted.
    """
    parts = {
        "content": hash_shot(tracks, scene),
        "source": hash_sources(fit_with_solution.__module__),
        "libraries": library_versions(),
    }

    def build(folder: Path) -> None:
        save_value(_ShotFit(fit_with_solution(tracks, scene)[1]), folder)

    return load_value(_ShotFit, cache.find_or_build(CacheKey(STAGE, parts), build).folder).solution
