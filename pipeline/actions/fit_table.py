"""Learn one table from all shots of run folders and track folders; the fit of each shot is cached, so it resumes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.core.errors import OptionError, TrackError, TruerollError
from models.core.joint_solution import JointSolution
from models.core.scene import Table
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.forecast.solution_state import MIN_NOISE_SPEED
from models.estimation.table_learning.learn_table import TableLesson, learn_table
from models.numerics.executor import Executor
from models.tracking.track_noise import apply_noise, estimate_noise
from pipeline.engine.result_cache import ResultCache
from pipeline.io.explained_shot import load_shot
from pipeline.io.observed_shot import list_shot_numbers, read_observed_shot
from pipeline.io.run_folder import drop_repeated_clips
from pipeline.io.table_profile import SIZE_TOLERANCE


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
    shots, refusals = _list_shots(sources)
    table = _require_one_table(shots, refusals)
    sources, repetitions = drop_repeated_clips(sources)
    if repetitions:
        shots, refusals = _list_shots(sources)
    refusals = [*repetitions, *refusals]
    fits, names = [], []
    for done, (name, source, number, _) in enumerate(shots):
        on_shot(done, len(shots))
        try:
            fits.append(prepare_shot(load_shot(source, number, cache)))
            names.append(name)
        except (TruerollError, ArithmeticError, ValueError) as error:
            refusals.append(f"{name}: {error}")
    on_shot(len(shots), len(shots))
    if not fits:
        raise TrackError(f"physics could be fitted to none of the shots; {refusals[0]}")
    try:
        lesson = learn_table(fits, table, executor=executor)
    except TrackError as error:
        raise TrackError("; ".join([str(error), *repetitions])) from error
    return FittedTable(lesson, table, len(fits), tuple(refusals), tuple(fits), tuple(names), tuple(sources))


ListedShot = tuple[str, Path, int, Table]
"""A shot of a session: name for messages, folder, number, table."""


def _list_shots(sources: list[Path]) -> tuple[list[ListedShot], list[str]]:
    """List all shots; also return one sentence per source or shot that cannot be read."""
    shots: list[ListedShot] = []
    refusals = []
    for source in sources:
        try:
            numbers = list_shot_numbers(source)
        except OptionError as error:
            refusals.append(str(error))
            continue
        for number in numbers:
            try:
                _, scene, _ = read_observed_shot(source, number)
            except OptionError as error:
                refusals.append(f"shot {number}: {error}")
            else:
                shots.append((f"{source}, shot {number}", source, number, scene.table))
    return shots, refusals


def _require_one_table(shots: list[ListedShot], refusals: list[str]) -> Table:
    """Return the table of all shots."""
    if not shots:
        raise OptionError(refusals[0] if refusals else "no shot was given: the tracks have no rows")
    first = shots[0][3]
    for name, _, _, table in shots:
        sizes = np.array([table.length, table.width, table.ball_radius])
        if np.any(np.abs(sizes / [first.length, first.width, first.ball_radius] - 1) > SIZE_TOLERANCE):
            raise OptionError(
                f"one table is learned at a time; {name} is {sizes[0]:g} x {sizes[1]:g} m, the first one"
                f" {first.length:g} x {first.width:g} m"
            )
    return first


def prepare_shot(shot: Shot) -> tuple[JointSolution, Tracks]:
    """Give the tracks of a shot capture times and realistic sigmas, as `learn_table` needs them.

    Args:
        shot: The shot.

    Returns:
        Joint solution and tracks, both at capture times.

    Raises:
        TrackError: Physics could not be fitted.
    """
    if shot.solution is None:
        raise TrackError("physics could not be fitted")
    captured = shot.capture_tracks
    noise = estimate_noise(captured, MIN_NOISE_SPEED, shot.scene.table.ball_radius)
    return shot.solution, apply_noise(captured, noise)
