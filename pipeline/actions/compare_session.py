"""Comparison of the shots of a session, from run folders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError, TrackError
from models.core.fit_result import ShotNumber, ShotNumbers
from models.core.naming import Naming
from models.estimation.shot_numbers.session_statistics import (
    SURE_RANGE,
    collect_session_numbers,
    compute_range_coverage,
    summarize_series,
)
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.io.run_folder import (
    find_repeated_clips,
    list_folders_with,
    parse_naming,
    read_scene_document,
)
from pipeline.io.strict_json import format_strict_json, replace_nonfinite
from pipeline.reporting.pages.session_page import MAIN_NUMBERS, write_session_page
from pipeline.reporting.text.number_sentences import SUMMARY_HEADINGS, list_summary_cells, name_heading, name_states
from pipeline.reporting.text.text_formatting import name_folders

Grouping = Literal["folder", "spin", "ball", "pocket", "side"]
GROUPINGS: tuple[Grouping, ...] = ("folder", "spin", "ball", "pocket", "side")
SCHEMA = "trueroll.session/1"


@dataclass(frozen=True, slots=True)
class SessionShot:
    """One shot of a session."""

    source: str
    """As the user named it: the run folder, or a folder of run folders."""
    folder: Path
    """Run folder."""
    shot: ShotNumbers
    naming: Naming


def read_shots(folder: Path, source: str = "") -> list[SessionShot]:
    """Read the numbers of the shots of a run folder.

    Args:
        folder: Run folder.
        source: As the user named it.

    Returns:
        Its shots.

    Raises:
        OptionError: There is no scene.json with such numbers.
    """
    document = read_scene_document(folder / "scene.json")
    try:
        naming = parse_naming(document)
        return [SessionShot(source, folder, shot, naming) for shot in parse_shot_numbers(document)]
    except OptionError as error:
        raise OptionError(f"{folder} {error}") from error


def parse_shot_numbers(scene: dict[str, Any]) -> tuple[ShotNumbers, ...]:
    """Parse the numbers of the shots of a scene.json.

    Args:
        scene: Content of the scene.json.

    Returns:
        Numbers per shot.

    Raises:
        OptionError: It has none, or they are malformed.
    """
    if "shot_numbers" not in scene:
        raise OptionError("was written by a version without shot numbers; run the clip again")
    try:
        return tuple(_parse_shot(entry) for entry in scene["shot_numbers"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise OptionError(f"has shot numbers that cannot be used: {error}") from error


def _parse_shot(entry: dict[str, Any]) -> ShotNumbers:
    potted = entry["potted"]
    return ShotNumbers(
        float(entry["t"]), str(entry["cue"]), str(entry["first"]), entry["spin_state"],
        tuple(float(p) for p in entry["spin_state_probabilities"].values()),
        tuple(str(one["ball"]) for one in potted), tuple(str(one["pocket"]) for one in potted),
        tuple(_parse_number(one) for one in entry["numbers"]),
    )  # fmt: skip


def _parse_number(entry: dict[str, Any]) -> ShotNumber:
    value, sigma = (float("nan") if entry[name] is None else float(entry[name]) for name in ("value", "sigma"))
    return ShotNumber(
        str(entry["name"]), value, sigma, str(entry["unit"]), bool(entry["observable"]), str(entry["ball"]),
        str(entry["place"]),
    )  # fmt: skip


def read_session(sources: Sequence[Path]) -> tuple[list[SessionShot], tuple[str, ...]]:
    """Read the shots of several sources.

    Args:
        sources: Run folders or folders of run folders.

    Returns:
        The shots, in the given order; and sentences on folders that are left out.

    Raises:
        OptionError: No folder has a shot.
    """
    shots: list[SessionShot] = []
    refusals = []
    folders = [source for source in sources if not source.is_file()]  # DIR/* names the table of a batch too
    for source in folders or sources:
        for folder in list_folders_with("scene.json", [source]):
            try:
                shots += read_shots(folder, str(source))
            except OptionError as error:
                refusals.append(str(error))
    if not shots:
        if refusals:
            raise OptionError(refusals[0])
        raise TrackError("no stroke here is at least 50 % probable; give runs of clips that begin before the stroke")
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
    shots, refusals = read_session(sources)
    _require_one_game(shots)
    columns = tabulate_session(shots, grouping)
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
    repetitions = tuple(
        f"{place} is a run of the same clip as {first}: its shots count twice, so that spreads are too small"
        for place, first in find_repeated_clips(one.folder for one in shots).items()
    )
    notes = (*repetitions, *_note_few_shots(len(owners)))
    title = f"{len(owners)} shot{'s' * (len(owners) != 1)} of {name_folders(sources)}"
    groups = {
        name or "all": [asdict(one) | {"has_trend": one.has_trend} for one in rows] for name, rows in summaries.items()
    }
    facts = {"schema": SCHEMA, "shots": len(owners), "groups": groups}
    document = replace_nonfinite({**facts, "refused": list(refusals), "repeated": list(repetitions)})
    write_columns(columns, folder / "session.csv", "needed")
    with replace_file(folder / "session.parquet") as path:
        pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path)
    write_text(folder / "session.json", format_strict_json(document))
    with replace_file(folder / "session.html") as path:
        write_session_page(columns, summaries, (*notes, *refusals), title, path)
    shown = [one for one in summaries[""] if one.count and one.name in MAIN_NUMBERS]
    return Answer(
        "How do the shots of this session differ?",
        (f"{title}:",),
        quantities=tuple(Quantity(one.name, one.median, one.measurement, one.unit) for one in shown),
        rows=(SUMMARY_HEADINGS, *(list_summary_cells(one, columns["heading"]) for one in shown)),
        notes=tuple(f"Note: {sentence}." for sentence in notes),
        refusals=refusals,
        document={"folder": str(folder), **document},
        figures=(str(folder / "session.html"),),
    )


def _note_few_shots(count: int) -> tuple[str, ...]:
    """Say how little few shots say about their level and spread; nothing for enough shots."""
    coverage = compute_range_coverage(count)
    if coverage >= SURE_RANGE:
        return ()
    enough = next(more for more in range(count, 100) if compute_range_coverage(more) >= SURE_RANGE)
    return (
        f"{count} shot{'s' * (count != 1)} say little about level and spread: the true middle lies within their range"
        f" with a probability of {100 * coverage:.0f} %; compare at least {enough}",
    )


def _require_one_game(shots: Sequence[SessionShot]) -> None:
    """Raise OptionError for shots of several games, whose numbers have no common level."""
    by_game: dict[str, list[str]] = {}
    for game, name in sorted({(one.naming.game, one.folder.name) for one in shots}):
        by_game.setdefault(game, []).append(name)
    if len(by_game) > 1:
        games = "; ".join(f"{game}: {', '.join(names)}" for game, names in by_game.items())
        raise OptionError(f"shots of one game are compared at a time; these are of {len(by_game)} ({games})")


def _name_group(grouping: Grouping, one: SessionShot) -> str:
    """Name the group of a shot; balls and pockets by what a viewer calls them, since ids differ from clip to clip."""
    shot, naming = one.shot, one.naming
    if grouping == "spin":
        return name_states(shot)[0] if shot.first else "no ball"
    if grouping == "ball":
        return naming.name_ball(shot.first) or "no ball"
    if grouping == "pocket":
        offset = shot.find_number("pocket_offset", shot.first) if shot.first else None
        return naming.name_pocket(offset.place) if offset is not None else "no pocket"
    if grouping == "side":
        cut = shot.find_number("cut_angle")
        return "no ball" if cut is None else "cut to the right" if cut.value > 0 else "cut to the left"
    return one.source


def tabulate_session(shots: Sequence[SessionShot], grouping: Grouping = "folder") -> Columns:
    """Arrange the shots of a session as columns.

    Args:
        shots: K shots.
        grouping: What shots of one group share.

    Returns:
        Columns (K,): texts, with balls and pockets by id and by name, then for every number its value and
        `NAME_sigma`; NaN where it is not observable.
    """
    entries = [collect_session_numbers(one.shot) for one in shots]
    groups = [_name_group(grouping, one) for one in shots]
    if grouping == "folder":
        names = {source: Path(source).resolve().name for source in groups}
        groups = [names[source] if [*names.values()].count(names[source]) == 1 else source for source in groups]
    columns: Columns = {
        "number": np.arange(1, len(shots) + 1), "group": groups, "folder": [str(one.folder) for one in shots],
        "t": np.array([one.shot.t for one in shots], np.float64),
        "cue": [one.shot.cue for one in shots], "first": [one.shot.first for one in shots],
        "first_name": [one.naming.name_ball(one.shot.first) for one in shots],
        "spin_state": [one.shot.spin_state for one in shots],
        "spin_name": [name_states(one.shot)[0] if one.shot.first else "" for one in shots],
        "heading": [
            name_heading(entry["direction"][0], one.naming) if entry.get("direction", (0, 0, "", False))[3] else ""
            for entry, one in zip(entries, shots, strict=True)
        ],
        "potted": [_join_pots(one.shot.potted, one.shot.pockets) for one in shots],
        "potted_names": [
            _join_pots(map(one.naming.name_ball, one.shot.potted), map(one.naming.name_pocket, one.shot.pockets))
            for one in shots
        ],
    }  # fmt: skip
    for name in dict.fromkeys(name for entry in entries for name in entry):
        pairs = [entry.get(name, (np.nan, np.nan, "", False)) for entry in entries]
        for column, place in ((name, 0), (f"{name}_sigma", 1)):
            columns[column] = np.array([pair[place] if pair[3] else np.nan for pair in pairs], np.float64)
    return columns


def _join_pots(balls: Iterable[str], pockets: Iterable[str]) -> str:
    return "; ".join(f"{ball} {pocket}" for ball, pocket in zip(balls, pockets, strict=True))
