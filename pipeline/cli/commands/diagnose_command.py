"""`trueroll diagnose`: diagnose the sim-to-real gap of run folders or track folders."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table as Grid

from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.number_format import format_probability
from pipeline.actions.convert_tracks import ConvertOptions
from pipeline.actions.diagnose_batch import diagnose_into
from pipeline.engine.helper_executor import open_executor
from pipeline.io.gap_files import PROFILE_FILE, build_gap_document
from pipeline.reporting.text.gap_sentences import (
    format_body_differences,
    format_gap_closure,
    format_shot_folders,
    format_shot_use,
    format_unexplained,
    format_verdict,
    list_causes,
)
from pipeline.terminal import command_line as cli

_MAX_CAUSES = 5


@cli.command("diagnose")
def diagnose_folders(
    inputs: Annotated[list[Path], typer.Argument(metavar="INPUT...")],
    out: Annotated[Path | None, cli.OUT] = None,
    scene: str | None = None,
    fps: Annotated[float | None, typer.Option(min=1e-9)] = None,
    px_per_m: Annotated[float | None, typer.Option(min=1e-9)] = None,
    as_json_: cli.JsonOption = False,
) -> None:
    """Find where a simulator differs from recorded motion, which effect it lacks, and how far that closes the gap.

    Args:
        inputs: Run folders, track folders or files of tracks, of one scene.
        out: Folder of the results. Default: INPUT/gap, beside a file NAME-gap.
        scene: Scene of files: billiards, flight, pendulum or slide.
        fps: Frame rate of files without times, in frames per second.
        px_per_m: Scale of files with positions in px, in px per m.
    """
    first = inputs[0]
    beside = first.with_name(f"{first.name.split('.')[0]}-gap") if first.is_file() else first / "gap"
    folder, options = out or beside, ConvertOptions(fps, px_per_m, None, scene)
    with open_executor() as executor:
        report, origins = diagnose_into(inputs, folder, _format_title(inputs), cli.console, executor, options=options)
    if as_json_:
        print(json.dumps({"folder": str(folder), **build_gap_document(report)}))
    else:
        _print_report(report, folder, origins)


def _format_title(inputs: list[Path]) -> str:
    """Return the name of the first folder and the number of the others."""
    first, more = inputs[0].resolve().name, len(inputs) - 1
    return f"{first} and {more} more" if more else first


def _print_report(report: DiagnosisReport, folder: Path, origins: Mapping[int, str]) -> None:
    screen = cli.make_output_console()
    screen.print(f"[bold]{escape(format_verdict(report))}[/]")
    screen.print(escape(format_gap_closure(report)))
    if shot_use := format_shot_use(report):
        screen.print(escape(shot_use))
    if report.candidates:
        grid = Grid("effect", "probability", "strength", box=None, pad_edge=False)
        for one in list_causes(report)[:_MAX_CAUSES]:
            grid.add_row(one.name, format_probability(one.probability), one.strength)
        screen.print(grid)
    for sentence in (*format_body_differences(report), *format_unexplained(report)):
        screen.print(escape(sentence))
    for note in report.notes if report.candidates else ():
        screen.print(escape(f"Note: {note}."))
    if report.film_next:
        screen.print(escape(report.film_next))
    if origins and report.candidates:
        screen.print(escape(format_shot_folders(origins)))
    print(f"Look at {folder / 'gap.html'}")
    if (folder / PROFILE_FILE).is_file():
        origin = "what comes nearest, which is not enough" if report.verdict == "unknown" else "what was found"
        print(f"The next run of this table can start from {origin}: --profile {folder / PROFILE_FILE}")
