"""Comparison of the shots of a session, from run folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.core.errors import OptionError
from models.core.shot_numbers import ShotNumbers
from models.estimation.shot_numbers.session_statistics import SeriesSummary, collect_session_numbers, summarize_series
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.io.run_folder import find_repeated_clips, read_scene_document
from pipeline.io.shot_numbers_json import parse_shot_numbers
from pipeline.io.strict_json import format_strict_json
from pipeline.reporting.pages.session_page import write_session_page

Grouping = Literal["folder", "spin", "ball", "pocket", "side"]
GROUPINGS: tuple[Grouping, ...] = ("folder", "spin", "ball", "pocket", "side")
SCHEMA = "trueroll.session/1"


@dataclass(frozen=True, slots=True)
class ComparedSession:
    """A session with its statistics."""

    columns: Columns
    """One row per shot."""
    summaries: dict[str, tuple[SeriesSummary, ...]]
    """Summaries of all numbers by group; those of the whole session under the empty name."""
    refusals: tuple[str, ...]
    """Sentences on folders that could not be read."""
    repetitions: tuple[str, ...]
    """Sentences on folders that are runs of one clip, whose shots count several times."""


def list_run_folders(source: Path) -> list[Path]:
    """List the run folders of a source.

    Args:
        source: A run folder, or a folder of run folders, such as that of a batch.

    Returns:
        The folders by name.

    Raises:
        OptionError: There is none.
    """
    if (source / "scene.json").is_file():
        return [source]
    folders = sorted(path.parent for path in source.rglob("scene.json")) if source.is_dir() else []
    if not folders:
        raise OptionError(f"A run folder or the folder of a batch was expected; there is no scene.json in {source}")
    return folders


def read_shot_numbers(folder: Path) -> tuple[ShotNumbers, ...]:
    """Read the numbers of the shots of a run folder.

    Args:
        folder: Run folder.

    Returns:
        Numbers per shot.

    Raises:
        OptionError: There is no scene.json with such numbers.
    """
    document = read_scene_document(folder / "scene.json")
    try:
        return parse_shot_numbers(document)
    except OptionError as error:
        raise OptionError(f"{folder} {error}") from error


def read_session(sources: Sequence[Path]) -> tuple[list[tuple[str, Path, ShotNumbers]], tuple[str, ...]]:
    """Read the shots of several sources.

    Args:
        sources: Run folders or folders of run folders.

    Returns:
        Source, run folder and numbers of each shot, in the given order; and sentences on folders that are left out.

    Raises:
        OptionError: No folder has a shot.
    """
    shots: list[tuple[str, Path, ShotNumbers]] = []
    refusals = []
    for source in sources:
        for folder in list_run_folders(source):
            try:
                shots += [(str(source), folder, shot) for shot in read_shot_numbers(folder)]
            except OptionError as error:
                refusals.append(str(error))
    if not shots:
        raise OptionError(refusals[0] if refusals else "no shot was struck in these folders")
    return shots, tuple(refusals)


def compare_session(sources: Sequence[Path], grouping: Grouping) -> ComparedSession:
    """Compare the shots of a session.

    Args:
        sources: Run folders or folders of run folders.
        grouping: What shots of one group share: the source, the state of spin at the first ball, the ball that is hit
            first, the pocket, or the side of the cut.

    Returns:
        The session.

    Raises:
        OptionError: No folder has a shot.
    """
    read, refusals = read_session(sources)
    shots = [
        SessionShot(_name_group(grouping, source, shot), str(folder), number, shot)
        for number, (source, folder, shot) in enumerate(read, start=1)
    ]
    columns = tabulate_session(shots)
    units = {name: unit for one in shots for name, (_, _, unit, _) in collect_session_numbers(one.shot).items()}
    owners, x = np.array(columns["group"]), np.asarray(columns["number"], np.float64)
    summaries = {}
    for group in ("", *dict.fromkeys(owners.tolist())):
        rows = owners == group if group else np.ones(len(owners), bool)
        summaries[group] = tuple(
            summarize_series(
                name, unit, x[rows], np.asarray(columns[name])[rows], np.asarray(columns[f"{name}_sigma"])[rows]
            )
            for name, unit in units.items()
        )
    repeated = find_repeated_clips(folder for _, folder, _ in read)
    repetitions = tuple(
        f"{folder} is a run of the same clip as {first}: its shots count twice, so that spreads are too small"
        for folder, first in repeated.items()
    )
    return ComparedSession(columns, summaries, refusals, repetitions)


def write_session(session: ComparedSession, title: str, folder: Path) -> dict[str, Any]:
    """Write session.html, session.csv, session.parquet and session.json.

    Args:
        session: The session.
        title: Heading of the page.
        folder: Folder of the results.

    Returns:
        Content of session.json.
    """
    folder.mkdir(parents=True, exist_ok=True)
    document = {
        "schema": SCHEMA,
        "shots": len(session.columns["number"]),
        "groups": {
            name or "all": [asdict(one) | {"has_trend": one.has_trend} for one in rows]
            for name, rows in session.summaries.items()
        },
        "refused": list(session.refusals),
        "repeated": list(session.repetitions),
    }
    with replace_file(folder / "session.csv") as table, replace_file(folder / "session.parquet") as parquet:
        write_session_tables(session.columns, table, parquet)
    write_text(folder / "session.json", format_strict_json(document))
    with replace_file(folder / "session.html") as path:
        write_session_page(session.columns, session.summaries, (*session.repetitions, *session.refusals), title, path)
    return document


def _name_group(grouping: Grouping, source: str, shot: ShotNumbers) -> str:
    if grouping == "spin":
        return shot.spin_state
    if grouping == "ball":
        return shot.first or "no ball"
    if grouping == "pocket":
        offset = shot.find_number("pocket_offset", shot.first) if shot.first else None
        return offset.place if offset is not None else "no pocket"
    if grouping == "side":
        cut = shot.find_number("cut_angle")
        return "no ball" if cut is None else "cut to the right" if cut.value > 0 else "cut to the left"
    return source


@dataclass(frozen=True, slots=True)
class SessionShot:
    """One shot of a session."""

    group: str
    folder: str
    """Run folder."""
    number: int
    """Number of the shot in the session, from 1."""
    shot: ShotNumbers


def tabulate_session(shots: Sequence[SessionShot]) -> Columns:
    """Arrange the shots of a session as columns.

    Args:
        shots: K shots.

    Returns:
        Columns (K,): texts, then for every number its value and `NAME_sigma`; NaN where it is not observable.
    """
    entries = [collect_session_numbers(one.shot) for one in shots]
    columns: Columns = {
        "number": np.array([one.number for one in shots], np.int64),
        "group": [one.group for one in shots], "folder": [one.folder for one in shots],
        "t": np.array([one.shot.t for one in shots], np.float64),
        "cue": [one.shot.cue for one in shots], "first": [one.shot.first for one in shots],
        "spin_state": [one.shot.spin_state for one in shots],
        "potted": [_format_potted(one.shot) for one in shots],
    }  # fmt: skip
    for name in dict.fromkeys(name for entry in entries for name in entry):
        pairs = [entry.get(name, (np.nan, np.nan, "", False)) for entry in entries]
        for column, place in ((name, 0), (f"{name}_sigma", 1)):
            columns[column] = np.array([pair[place] if pair[3] else np.nan for pair in pairs], np.float64)
    return columns


def _format_potted(shot: ShotNumbers) -> str:
    return "; ".join(f"{ball} {pocket}" for ball, pocket in zip(shot.potted, shot.pockets, strict=True))


def write_session_tables(columns: Columns, table: Path, parquet: Path) -> None:
    """Write the columns of a session.

    Args:
        columns: Columns of `tabulate_session`.
        table: CSV file to write.
        parquet: Parquet file to write.
    """
    write_columns(columns, table, "needed")
    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), parquet)
