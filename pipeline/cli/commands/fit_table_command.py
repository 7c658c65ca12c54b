"""`trueroll fit-table`: learn the physics of one table from many shots."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from pipeline.actions.fit_table import learn_table_profile
from pipeline.engine.atomic_write import parse_output_path
from pipeline.engine.helper_executor import open_executor
from pipeline.engine.result_cache import open_cache
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore


@answer_command("fit-table")
def fit_table(
    *inputs: Annotated[cli.AnyPath, typer.Argument(metavar="DIR|tracks.csv...")],
    out: Annotated[cli.AnyPath, cli.make_output_option(metavar="FILE")] = "profile.json",
    cache: cli.AnyCacheOption = None,
    on_activity: Callable[[str], None] = ignore,
) -> Answer:
    """Learn one table from many shots, for `--profile` of `run`, `call`, `predict` and `simulate`.

    The fit of every shot is cached, so that a second call resumes, and a larger one continues.

    Args:
        inputs: Run folders or track folders of one table, all their shots.
        out: The profile to write.
    """
    store = open_cache(cache)
    with open_executor() as executor:
        return learn_table_profile([Path(one) for one in inputs], parse_output_path(out), store, executor, on_activity)
