"""`trueroll compare`: the shots of a session as a table and plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.core.errors import OptionError
from pipeline.actions.compare_session import GROUPINGS, Grouping, compare_session
from pipeline.engine.atomic_write import parse_output_path, require_writable_folder
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command


@answer_command("compare")
def compare(
    *folders: Annotated[cli.AnyPath, typer.Argument(metavar="DIR...")],
    out: Annotated[cli.AnyPath, cli.OUT] = "out/session",
    group: Grouping = "folder",
) -> Answer:
    """Compare the shots of a session: level, spread and trend of every number, as a page, CSV and Parquet.

    Args:
        folders: Run folders, or folders of run folders, such as a batch.
        out: Folder of the results, which is none of DIR.
        group: What the shots of a group share: folder (of the command line), spin (at the first ball), ball (that is
            hit first), pocket, side (of the cut).
    """
    if group not in GROUPINGS:
        raise OptionError(f"--group is one of {', '.join(GROUPINGS)}; got {group}")
    folder = parse_output_path(out)
    require_writable_folder(folder)
    return compare_session([Path(one) for one in folders], group, folder)
