"""`trueroll diagnose`: diagnose the sim-to-real gap of run folders or track folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
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
    name_runs,
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
    simulator: str | None = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Find where a simulator differs from recorded motion, which effect it lacks, and how far that closes the gap.

    Args:
        inputs: Run folders, track folders or files of tracks, of one scene.
        out: Folder of the results. Default: INPUT/gap, beside a file NAME-gap.
        scene: Scene of files: billiards, flight, pendulum or slide.
        fps: Frame rate of files without times, in frames per second.
        px_per_m: Scale of files with positions in px, in px per m.
        simulator: Your own simulator: FILE.xml of MuJoCo, MODULE:FUNCTION of Python, (state, inputs, dt) -> state, or
            a table of its predictions. INPUT are then tables with a column per joint (rad or m) and t (s), MCAP files
            or ROS 2 bags. Or pooltool, for the run folders and track folders of billiards.
    """
    first = inputs[0]
    beside = first.with_name(f"{first.name.split('.')[0]}-gap") if first.is_file() else first / "gap"
    folder, options = out or beside, ConvertOptions(fps, px_per_m, None, scene)
    with open_executor() as executor:
        report, origins = diagnose_into(
            inputs, folder, _format_title(inputs), cli.console, executor, options=options, simulator=simulator
        )
    notes = [f"Note: {note}." for note in report.notes] if report.candidates else []
    notes += [report.film_next, format_shot_folders(origins) if origins and report.candidates else ""]
    if (folder / PROFILE_FILE).is_file():
        origin = "what comes nearest, which is not enough" if report.verdict == "unknown" else "what was found"
        notes.append(f"The next run of this table can start from {origin}: --profile {folder / PROFILE_FILE}")
    if simulator is not None and (folder / "recording.rrd").is_file():
        notes.append(f"To see the predictions move beside what was recorded: trueroll view {folder}")
    causes = [(one.name, format_probability(one.probability), one.strength) for one in list_causes(report)]

    def say(*sentences: str) -> tuple[str, ...]:
        return tuple(name_runs(report.scene, one) for one in sentences if one)

    answer = Answer(
        "Which effect does the simulator lack?",
        say(format_verdict(report), format_gap_closure(report), format_shot_use(report)),
        rows=(("effect", "probability", "strength"), *causes[:_MAX_CAUSES]) if report.candidates else (),
        notes=say(*format_body_differences(report), *format_unexplained(report), *notes),
        document={"folder": str(folder), **build_gap_document(report)},
        figures=(str(folder / "gap.html"),),
    )
    cli.print_answer(answer, as_json)


def _format_title(inputs: list[Path]) -> str:
    """Return the name of the first folder and the number of the others."""
    first, more = inputs[0].resolve().name, len(inputs) - 1
    return f"{first} and {more} more" if more else first
