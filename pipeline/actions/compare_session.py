"""Comparison of the shots of a session, from run folders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError
from models.core.shot_numbers import ShotNumbers
from models.estimation.shot_numbers.session_statistics import collect_session_numbers, summarize_series
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.io.run_folder import find_repeated_clips, list_folders_with, parse_table, read_scene_document
from pipeline.io.shot_numbers_json import parse_shot_numbers
from pipeline.io.strict_json import format_strict_json
from pipeline.reporting.pages.session_page import MAIN_NUMBERS, write_session_page
from pipeline.reporting.text.session_sentences import SUMMARY_HEADINGS, list_summary_cells
from pipeline.reporting.text.text_formatting import name_folders

Grouping = Literal["folder", "spin", "ball", "pocket", "side"]
GROUPINGS: tuple[Grouping, ...] = ("folder", "spin", "ball", "pocket", "side")
SCHEMA = "trueroll.session/1"


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
    folders = [source for source in sources if not source.is_file()]  # DIR/* names the table of a batch too
    for source in folders or sources:
        for folder in list_folders_with("scene.json", [source]):
            try:
                shots += [(str(source), folder, shot) for shot in read_shot_numbers(folder)]
            except OptionError as error:
                refusals.append(str(error))
    if not shots:
        raise OptionError(refusals[0] if refusals else "no shot was struck in these folders")
    return shots, tuple(refusals)


def compare_session(sources: Sequence[Path], grouping: Grouping, folder: Path) -> Answer:
    """Compare the shots of a session, and write session.html, session.csv, session.parquet and session.json.

    Args:
        sources: Run folders or folders of run folders.
        grouping: What shots of one group share: the source, the state of spin at the first ball, the ball that is hit
            first, the pocket, or the side of the cut.
        folder: Folder of the results; created if it does not exist.

    Returns:
        Level, spread and trend of every number.

    Raises:
        OptionError: No folder has a shot, or the shots are of several games.
    """
    read, refusals = read_session(sources)
    _require_one_game({place for _, place, _ in read})
    columns = tabulate_session(
        [
            SessionShot(_name_group(grouping, source, shot), str(place), number, shot)
            for number, (source, place, shot) in enumerate(read, start=1)
        ]
    )
    units = {name: unit for _, _, one in read for name, (_, _, unit, _) in collect_session_numbers(one).items()}
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
    repetitions = tuple(
        f"{place} is a run of the same clip as {first}: its shots count twice, so that spreads are too small"
        for place, first in find_repeated_clips(place for _, place, _ in read).items()
    )
    title = f"{len(owners)} shot{'s' * (len(owners) != 1)} of {name_folders(sources)}"
    document = {
        "schema": SCHEMA,
        "shots": len(owners),
        "groups": {
            name or "all": [asdict(one) | {"has_trend": one.has_trend} for one in rows]
            for name, rows in summaries.items()
        },
        "refused": list(refusals),
        "repeated": list(repetitions),
    }
    folder.mkdir(parents=True, exist_ok=True)
    with replace_file(folder / "session.csv") as table, replace_file(folder / "session.parquet") as parquet:
        write_session_tables(columns, table, parquet)
    write_text(folder / "session.json", format_strict_json(document))
    with replace_file(folder / "session.html") as path:
        write_session_page(columns, summaries, (*repetitions, *refusals), title, path)
    shown = [one for one in summaries[""] if one.count and one.name in MAIN_NUMBERS]
    return Answer(
        "How do the shots of this session differ?",
        (f"{title}:",),
        quantities=tuple(Quantity(one.name, one.median, one.measurement, one.unit) for one in shown),
        rows=(SUMMARY_HEADINGS, *map(list_summary_cells, shown)),
        notes=tuple(f"Note: {sentence}." for sentence in repetitions),
        refusals=refusals,
        document={"folder": str(folder), **document},
        figures=(str(folder / "session.html"),),
    )


def _require_one_game(folders: Iterable[Path]) -> None:
    """Raise OptionError for run folders of several games, whose numbers have no common level."""
    by_game: dict[str, list[str]] = {}
    for folder in sorted(folders):
        game = parse_table(read_scene_document(folder / "scene.json")).game
        by_game.setdefault(game, []).append(folder.name)
    if len(by_game) > 1:
        games = "; ".join(f"{game}: {', '.join(names)}" for game, names in by_game.items())
        raise OptionError(f"shots of one game are compared at a time; these are of {len(by_game)} ({games})")


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
