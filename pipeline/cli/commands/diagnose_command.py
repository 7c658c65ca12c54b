"""trueroll diagnose: the sim-to-real gap of run folders or track folders."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table as Grid

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import Report
from pipeline.chain import refuse_closed
from pipeline.engine.helper_process import crew
from pipeline.io.gap_files import as_json, write_gap
from pipeline.io.profile_export import PROFILE, write_cure
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import open_scene, table_of
from pipeline.reporting.pages.gap_page import write_gap_page
from pipeline.reporting.text.gap_sentences import causes, closed_sentence, folders_of_shots, gap_sentence
from pipeline.terminal.command_line import DebugOption, JsonOption, app, console, named, standard_output
from pipeline.terminal.search_display import search_display

_SHOWN = 5


@app.command("diagnose")
def diagnose_folders(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="INPUT...", help="Run folders or track folders of one scene.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder; INPUT/gap if not given."),
    ] = None,
    as_json_: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Where simulator and world part, which effect is missing, and how far the gap shrinks with it."""
    folder = out if out is not None else inputs[0] / "gap"
    read = read_track_folders(inputs)
    refuse_closed(folder)
    scene = open_scene(read)
    with crew() as workers, search_display(console) as watch:
        report = diagnose(scene, read.recordings, watch=watch, crew=workers)
    report = replace(report, notes=(*report.notes, *read.notes))
    write_gap(report, folder)
    if (table := table_of(scene)) is not None:
        write_cure(report, table, folder)
    write_gap_page(report, _title(inputs), folder / "gap.html", table, read.origins)
    os.environ.setdefault("RUST_LOG", "off")  # rerun would print what it raises; it reads this when it is imported
    from pipeline.reporting.recording.gap_layer import write_gap_recording  # slow to import

    write_gap_recording(report, inputs, folder / "gap.rrd")
    if as_json_:
        print(json.dumps({"folder": str(folder), **as_json(report)}, allow_nan=False))
    else:
        _tell(report, folder, read.origins)


def _title(inputs: list[Path]) -> str:
    """The first folder's name, and how many more there are."""
    first, more = inputs[0].resolve().name, len(inputs) - 1
    return f"{first} and {more} more" if more else first


def _tell(report: Report, folder: Path, origins: Mapping[int, str]) -> None:
    screen = standard_output()
    screen.print(f"[bold]{escape(gap_sentence(report))}[/]")
    screen.print(escape(closed_sentence(report)))
    if report.candidates:
        grid = Grid("cause", "probability", "strength", box=None, pad_edge=False)
        for one in causes(report)[:_SHOWN]:
            grid.add_row(one.name, f"{one.probability:.1%}", one.strength)
        screen.print(grid)
    for note in report.notes if report.candidates else ():
        screen.print(escape(f"Note: {note}."))
    if report.film_next:
        screen.print(escape(report.film_next))
    if origins and report.candidates:
        screen.print(escape(folders_of_shots(origins)))
    print(f"Look at {folder / 'gap.html'}; trueroll view {folder} draws where it shows")
    if (folder / PROFILE).is_file():
        found = "what comes nearest, which is not enough" if report.verdict == "unknown" else "what was found"
        print(f"The next run of this table can start from {found}: --profile {folder / PROFILE}")
