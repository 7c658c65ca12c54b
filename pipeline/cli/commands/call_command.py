"""`trueroll call`: answer an umpire's question about a shot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.actions.answer_call import answer_question, build_call_answer, write_call_images
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.run_record import read_shot_record
from pipeline.io.table_profile import parse_cloth_priors, read_profile_text
from pipeline.terminal import command_line as cli


@cli.app.command("call")
def call_umpire(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")],
    question: Annotated[
        list[str],
        typer.Argument(
            metavar="QUESTION", help="contact A B | first A | cushion-first A | pocket A top-left | line x=0.635 A"
        ),
    ],
    edge: Annotated[
        bool, typer.Option("--edge", help="For line: whether the edge of the ball crosses, instead of its centre.")
    ] = False,
    clip: Annotated[
        Path | None, typer.Option("--clip", help="Clip of the shot. Default: the path that the run noted.")
    ] = None,
    out: cli.OutBesideOption = None,
    shot: Annotated[int, typer.Option("--shot", help="Number of the shot in the folder.")] = 0,
    profile: Annotated[
        Path | None,
        typer.Option(
            "--profile",
            metavar="FILE",
            help="Table profile of trueroll fit-table or diagnose: its friction decides close passes of two balls.",
        ),
    ] = None,
    as_json: cli.JsonOption = False,
    debug: cli.DebugOption = False,
) -> None:
    """Answer an umpire's question: a probability, a time, a margin in mm, and a close-up of the moment."""
    cloth = None if profile is None else parse_cloth_priors(read_profile_text(profile))
    record = read_shot_record(folder, shot, cloth)
    target = folder if out is None else out
    require_writable_folder(target)
    call = answer_question(record, question, edge)
    pictures, why_not = write_call_images(record, call, folder, clip, target, question)
    answer = build_call_answer(record, call, question, pictures, why_not)
    cli.print_answer(answer, as_json)
    if not as_json and not pictures:
        print(f"No picture: {why_not}")
