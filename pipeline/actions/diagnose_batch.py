"""Diagnosis of a session or a batch: all shots of a table are diagnosed together, as they share its cloth and slope.

On a terminal, the time left is that of the steps so far, times the number of steps that usually follow: right within a
factor of two.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from diagnosis.diagnose import diagnose
from diagnosis.fitting.display_names import format_cause
from diagnosis.selection.hypotheses import ProgressCallback, SearchOutlook
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.numerics.executor import Executor
from pipeline.actions.convert_tracks import NOTHING_STATED, ConvertOptions, import_tracks
from pipeline.batch.clip_job import ClipResult
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.engine.helper_executor import open_executor
from pipeline.io.gap_files import write_gap_files, write_profile_files
from pipeline.io.long_recordings import cut_pendulums
from pipeline.io.saved_shot import holds_rally
from pipeline.io.simulators.pooltool_simulator import POOLTOOL_NAME
from pipeline.io.strict_json import read_json
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import billiards_table, build_gap_scene
from pipeline.io.view_profile import collect_views
from pipeline.reporting.pages.gap_page import write_gap_page
from pipeline.reporting.text.gap_sentences import format_verdict
from pipeline.reporting.text.text_formatting import format_error
from pipeline.simulator_diagnosis import describe_coefficients, diagnose_mechanism, pair_with_pooltool
from pipeline.terminal.progress_display import show_activity

# CIE 1976 colour difference below which two cloths are regarded as the same: half the difference of a green and a blue
# cloth, and more than changes of the light cause.
MAX_CLOTH_DISTANCE = 15.0
# Least time between two lines about the search in a file, s: a diagnosis of a minute leaves a few of them.
_LOG_INTERVAL_S = 10.0

# Name, length, width and ball radius (m) of a table.
TableSize = tuple[str, float, float, float]


@dataclass(frozen=True, slots=True)
class TableShots:
    """The run folders of one table."""

    name: str
    folders: tuple[Path, ...]


def group_by_table(rows: Iterable[ClipResult]) -> list[TableShots]:
    """Group the runs of a batch by table size and cloth colour.

    Args:
        rows: Results of the clips.

    Returns:
        The tables with their run folders; runs with a red trust level are left out.
    """
    groups: list[tuple[TableSize, FloatArray, list[Path]]] = []
    for folder, light in _list_runs(rows):
        size, colour = _read_table_key(folder)
        for other, group_colour, folders in groups:
            if light != "red" and other == size and not np.linalg.norm(group_colour - colour) > MAX_CLOTH_DISTANCE:
                folders.append(folder)
                break
        else:
            if light != "red":
                groups.append((size, colour, [folder]))
    names = [re.sub(r"[^\w-]", "_", size[0]) or f"{size[1]:g}x{size[2]:g}".replace(".", "_") for size, _, _ in groups]
    return [
        TableShots(f"table-{k + 1:02d}-{name}", tuple(folders))
        for k, (name, (_, _, folders)) in enumerate(zip(names, groups, strict=True))
    ]


def diagnose_tables(tables: Iterable[TableShots], out: Path, console: Console) -> Iterator[tuple[TableShots, str]]:
    """Diagnose every table and write OUT/gap/TABLE/gap.json, gap.html, gap_predictions.csv and its profile.

    Args:
        tables: Tables with their run folders.
        out: Folder of the batch.
        console: Console that shows the progress of the search.

    Yields:
        Each table with its verdict, or with the error that prevented its diagnosis.
    """
    listed_tables = list(tables)
    if not listed_tables:
        return
    with open_executor() as workers:
        for table in listed_tables:
            try:
                report, _ = diagnose_into(
                    table.folders, out / "gap" / table.name, table.name, console, workers, table.name
                )
            except Exception as error:  # an error of one table must not stop the others
                yield table, format_error(error)
            else:
                yield table, format_verdict(report)


def diagnose_into(
    inputs: Sequence[Path],
    folder: Path,
    title: str,
    console: Console,
    workers: Executor,
    shown_title: str = "",
    options: ConvertOptions = NOTHING_STATED,
    simulator: str | None = None,
) -> tuple[DiagnosisReport, Mapping[int, str]]:
    """Diagnose the shots of one scene, and write the report's files and its page.

    Args:
        inputs: Run folders, track folders, or files of tracks; with a simulator, recordings of its joints.
        folder: Folder of the results.
        title: Heading of the page.
        console: Shows the progress.
        workers: Distributes the fits over processes.
        shown_title: Words before the progress.
        options: What files of tracks may lack.
        simulator: `pooltool`, or a simulator of a mechanism, see `read_mechanism_shots`; None for our own.

    Returns:
        The report, and the origin of each shot.

    Raises:
        OptionError: The inputs cannot be read, or are no shots of one scene.
    """
    has_joints = simulator is not None and simulator != POOLTOOL_NAME
    if has_joints and options != NOTHING_STATED:
        raise OptionError(
            "--scene, --fps and --px-per-m are of tracks; a recording of joints has a column t, in s, and its simulator"
            " states the units: leave them out beside --simulator"
        )
    require_writable_folder(folder)
    if simulator is not None and has_joints:
        from pipeline.reporting.recording.gap_recording import write_gap_recording

        def print_note(note: str) -> None:
            console.print(f"Note: {note}.", markup=False, soft_wrap=True)

        with show_search_progress(console, shown_title) as watch:
            report, origins, shots = diagnose_mechanism(inputs, simulator, 0, watch, workers, print_note)
        write_gap_files(report, folder)
        write_gap_page(report, title, folder / "gap.html", origins=origins, shots=shots)
        write_gap_recording(report, shots.simulator, folder / "recording.rrd", title, origins)
        return report, origins
    folders, sources = import_tracks(inputs, folder / "tracks", options)
    read = cut_pendulums(read_track_folders(folders))
    scene = build_gap_scene(read)
    if simulator == POOLTOOL_NAME:
        scene = pair_with_pooltool(scene)
    with show_search_progress(console, shown_title) as watch:
        report = diagnose(scene, read.recordings, on_progress=watch, executor=workers)
    report = replace(report, notes=(*describe_coefficients(report), *report.notes, *sources, *read.notes))
    write_gap_files(report, folder)
    if (table := billiards_table(scene)) is not None:
        write_profile_files(report, table, folder, collect_views(folders))
    write_gap_page(report, title, folder / "gap.html", table, read.origins)
    return report, read.origins


def _list_runs(rows: Iterable[ClipResult]) -> Iterator[tuple[Path, str]]:
    """List the folder of every shot of billiards with its trust level."""
    yield from (run for run in _list_all_runs(rows) if not holds_rally(run[0]))


def _list_all_runs(rows: Iterable[ClipResult]) -> Iterator[tuple[Path, str]]:
    """List the folder of every shot or rally with its trust level."""
    for row in rows:
        folder = Path(row.folder)
        if row.status == "done" and row.in_shots:
            shots = read_json(folder / "scene.json", "A run folder has a scene.json").get("shots", [])
            yield from ((folder / shot["folder"], shot["trust"]) for shot in shots)
        elif row.status == "done":
            yield folder, row.trust


def _read_table_key(folder: Path) -> tuple[TableSize, FloatArray]:
    scene = read_json(folder / "scene.json", "A run folder has a scene.json")
    table = scene.get("table") or {}
    size = (str(table.get("name") or ""), float(table["length"]), float(table["width"]), float(scene["ball_radius"]))
    return size, np.array(table.get("cloth_lab") or [np.nan] * 3, dtype=np.float64)


@contextmanager
def show_search_progress(console: Console, title: str = "") -> Iterator[ProgressCallback]:
    """Show what the diagnosis does and for how long it has run.

    Args:
        console: Console of the display.
        title: Name of the table, if there are several.

    Yields:
        A function that is called with the activity, the effects that are tried, and the outlook of the search.
    """
    begun = time.monotonic()
    with show_activity(console, title, least_interval=_LOG_INTERVAL_S) as show:

        def update(activity: str, names: tuple[str, ...], outlook: SearchOutlook) -> None:
            effects = f": {' and '.join(map(format_cause, names))}" if names else ""
            show(f"{activity}{effects}{_format_outlook(outlook, time.monotonic() - begun)}")

        show("looking at the tracks")
        yield update


def _format_outlook(outlook: SearchOutlook, seconds: float) -> str:
    """Format the best hypothesis so far and the estimated time left after `seconds` as the rest of a line."""
    parts = []
    if outlook.best is not None:
        parts.append(f"best so far: {' and '.join(map(format_cause, outlook.best or ('none',)))}")
    if outlook.steps_done:
        parts.append(f"about {seconds / outlook.steps_done * outlook.steps_left:.0f} s left")
    return f" ({'; '.join(parts)})" if parts else ""
