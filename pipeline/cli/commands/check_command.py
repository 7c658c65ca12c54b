"""`trueroll check`: check how a clip is filmed, before more shots are filmed."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from textwrap import wrap
from typing import Annotated

import numpy as np
import typer

from models.core.errors import ClipError, OptionError
from models.core.typing import ImageArray
from pipeline.actions.check_clip import FilmingReport, check_clip, state_filming
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.image_file import write_image
from pipeline.reporting.text.filming_sentences import (
    VERDICT_WORDS,
    WORDS,
    format_advice,
    format_value,
)
from pipeline.settings import DoorOptions, build_door_options, list_door_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings
from video.drawing.palette import MUTED_GREY, TRUST_COLOURS, WHITE
from video.overlay.filming_still import PanelLine, TableOutline, count_panel_letters, draw_filming_still

PANEL_SIGNS = {"good": "+", "doubt": "!", "bad": "x", "unknown": "?"}
LEVEL_COLOURS = {
    "good": TRUST_COLOURS["green"], "doubt": TRUST_COLOURS["amber"], "bad": TRUST_COLOURS["red"], "unknown": MUTED_GREY,
}  # fmt: skip
VERDICT_LEVELS = {"go": "good", "doubts": "doubt", "no-go": "bad"}


@cli.command("check")
@add_settings(list_door_settings(), build_door_options)
def check(
    clip: Path,
    out: Annotated[Path | None, cli.make_output_option(metavar="FILE.png")] = None,
    as_json: cli.JsonOption = False,
    *,
    options: DoorOptions,
) -> None:
    """Check in a few seconds how a clip is filmed: go or no-go before more shots are filmed (exit status 0 or 1).

    Args:
        clip: A clip of a shot or of a rally: mp4, mov, mkv, avi, webm.
        out: Write a still with the table, the balls and what is wrong.
    """
    if out is not None:
        if out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
            raise OptionError(f"-o is an image, .png or .jpg; got {out.name}")
        require_writable_folder(out.parent)
    if options.court.has_court:
        _show_court(clip, options, out, as_json)
        return
    report = check_clip(clip, options)
    if report.refusal and options.court.sport is None:
        with suppress(ClipError):  # no court either: what is wrong with the table is the answer
            _show_court(clip, options, out, as_json)
            return
    cli.print_answer(state_filming(report), as_json)
    if out is not None:
        write_image(_draw_still(report), out)
    if report.verdict == "no-go":
        raise typer.Exit(1)


def _show_court(clip: Path, options: DoorOptions, out: Path | None, as_json: bool) -> None:
    """Show how a clip of a court is filmed; raises ClipError where it shows none."""
    from pipeline.actions.check_court import check_court  # slow to import

    report = check_court(clip, options)
    cli.print_answer(report.answer, as_json)
    if out is not None:
        write_image(report.image, out)
    if report.answer.verdict == "no-go":
        raise typer.Exit(1)


def _draw_still(report: FilmingReport) -> ImageArray:
    """Draw the annotated still."""
    view, first = report.view, report.detections.frame == 0
    letters = count_panel_letters(report.still.shape)
    lines = [
        PanelLine(text, LEVEL_COLOURS[VERDICT_LEVELS[report.verdict]], True)
        for text in wrap(VERDICT_WORDS[report.verdict], letters)
    ]
    lines.append(PanelLine("", WHITE))
    for one in report.measurements:
        words = f"{PANEL_SIGNS[one.level]} {WORDS[one.code].name}: {format_value(one)}"
        lines += [PanelLine(text, LEVEL_COLOURS[one.level]) for text in wrap(words, letters, subsequent_indent="   ")]
    for advice in format_advice(report.measurements, report.refusal):
        lines.append(PanelLine("", WHITE))
        lines += [PanelLine(text, WHITE) for text in wrap(advice, letters)]
    outline = None
    if view.scene is not None:
        balls = report.detections
        outline = TableOutline(view.corners, np.asarray(balls.centre[first]), np.asarray(balls.radius[first]))
    return draw_filming_still(report.still, outline, view.glare, lines)
