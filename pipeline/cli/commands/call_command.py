"""`trueroll call`: answer an umpire's question about a shot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.core.errors import OptionError
from pipeline.actions.answer_call import answer_call
from pipeline.engine.atomic_write import parse_output_path
from pipeline.io.run_views import read_shot_record
from pipeline.io.saved_shot import holds_rally, read_rally, read_saved, require_rally
from pipeline.io.table_profile import parse_cloth_priors, read_profile_text
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore


@answer_command("call")
def call(
    folder: Annotated[cli.AnyPath, typer.Argument(metavar="DIR")],
    *question: Annotated[str, typer.Argument(metavar="QUESTION")],
    edge: bool = False,
    on: str = "",
    singles: bool = False,
    doubles: bool = False,
    service_box: bool = False,
    clip: cli.AnyPath | None = None,
    out: cli.OutBesideOption = None,
    share: Annotated[cli.AnyPath | None, typer.Option(metavar="FILE.mp4")] = None,
    profile: Annotated[cli.AnyPath | None, typer.Option(metavar="FILE")] = None,
    on_activity: Callable[[str], None] = ignore,
) -> Answer:
    """Answer an umpire's question with a probability, a time, a margin in mm, and a close-up of the moment.

    Args:
        folder: The folder of a run.
        question: contact A B | rail A left | first A | cushion-first A | pocket A top-left | line x=0.635 A | score |
            foul; of a rally: landing | net
        edge: For line: whether the edge of the ball crosses, instead of its centre.
        on: For foul: what must be hit first: solids, stripes, eight, red, colour, a ball.
        singles: For landing: whether it is in the singles court. Default: what the sport plays most.
        doubles: For landing: whether it is in the doubles court.
        service_box: For landing: whether it is in the box of the service.
        clip: Clip of the shot. Default: the path that the run noted.
        share: Write a clip of ten seconds for phones too: the moment in slow motion, and its answer.
        profile: Table profile of trueroll fit-table or diagnose: its friction decides close passes of two balls.
    """
    target = parse_output_path(folder if out is None else out)
    areas = [name for name, is_chosen in
             (("singles", singles), ("doubles", doubles), ("service-box", service_box)) if is_chosen]  # fmt: skip
    noted, shared = (None if one is None else Path(one) for one in (clip, share))
    if holds_rally(Path(folder)):
        from pipeline.actions.judge_rally import answer_rally_call

        if len(areas) > 1 or edge or on or share is not None or profile is not None:
            raise OptionError("of a rally, ask landing, with one of --singles, --doubles, --service-box, or net")
        area = areas[0] if areas else None
        return answer_rally_call(read_rally(Path(folder)), question, area, Path(folder), noted, target)
    if areas or question[:1] in (("landing",), ("net",)):
        require_rally(read_saved(Path(folder)), Path(folder))
    cloth = None if profile is None else parse_cloth_priors(read_profile_text(Path(profile)))
    record = read_shot_record(Path(folder), cloth)
    if share is not None:
        on_activity("Rendering the clip to share")
    return answer_call(record, question, edge, Path(folder), noted, target, on, shared)
