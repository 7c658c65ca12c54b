"""trueroll call: an umpire's question about a shot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from models.estimation.contact_test.call_answers import Call
from pipeline.actions.answer_call import ask, picture_call
from pipeline.chain import refuse_closed
from pipeline.io.run_folder import read_record
from pipeline.terminal.command_line import DebugOption, JsonOption, app, named


@app.command("call")
def call(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")],
    question: Annotated[
        list[str],
        typer.Argument(
            metavar="QUESTION",
            help="contact A B | first A | cushion-first A | pocket A top-left | line x=0.635 A",
        ),
    ],
    edge: Annotated[bool, typer.Option("--edge", help="line: ask for the ball's edge instead of its centre.")] = False,
    clip: Annotated[
        Path | None, typer.Option("--clip", help="The video of the shot; found by itself where the run noted it.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder of the pictures; DIR.")
    ] = None,
    shot: Annotated[int, typer.Option("--shot", help="Which shot of the folder.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """An umpire's question: a probability, a time, a margin in mm, and a close-up of the moment."""
    record = read_record(folder, shot)
    target = folder if out is None else out
    refuse_closed(target)
    answer = ask(record, question, edge)
    pictures, why_not = picture_call(record, answer, folder, clip, target, question)
    if as_json:
        print(json.dumps(_as_json(answer, question, pictures, why_not), allow_nan=False))
        return
    print(answer.sentence)
    print(f"Look at {' and '.join(str(path) for path in pictures)}" if pictures else f"No picture: {why_not}")


def _as_json(answer: Call, question: list[str], pictures: list[Path], why_not: str) -> dict[str, Any]:
    numbers = {
        "probability": answer.probability, "t": answer.t, "t_sigma": answer.t_sigma, "frame": answer.frame,
        "margin_mm": 1e3 * answer.margin, "margin_mm_sigma": 1e3 * answer.margin_sigma,
    }  # fmt: skip
    return {
        "question": " ".join(question), "verdict": answer.verdict,
        **{name: value if value == value else None for name, value in numbers.items()},
        "sentence": answer.sentence, "moved": list(answer.moved),
        "alternatives": [{"answer": name, "probability": p} for name, p in answer.alternatives],
        "pictures": [str(path) for path in pictures], "no_picture": why_not or None,
    }  # fmt: skip
