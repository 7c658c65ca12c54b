"""`trueroll certify`: measure a table by the shots of a session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from pipeline.actions.certify_table import certify_table
from pipeline.engine.atomic_write import parse_output_path, require_writable_folder
from pipeline.engine.helper_executor import open_executor
from pipeline.engine.result_cache import open_cache
from pipeline.io.certificate_files import read_certificate
from pipeline.io.run_folder import list_folders_with
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore


@answer_command("certify")
def certify(
    *inputs: Annotated[cli.AnyPath, typer.Argument(metavar="DIR...")],
    out: Annotated[cli.AnyPath, cli.OUT] = "certificate",
    compare: Annotated[cli.AnyPath | None, typer.Option(metavar="OTHER.json")] = None,
    cache: cli.AnyCacheOption = None,
    on_activity: Callable[[str], None] = ignore,
) -> Answer:
    """Certify a table: slope, restitution, speed of the cloth, size and squareness, each with its error.

    The fit of every shot is cached, so that a second call resumes, and a larger one continues.

    Args:
        inputs: Run folders, track folders or a batch's folder, all of one table.
        out: Folder of the certificate.
        compare: An earlier certificate: which numbers differ from it.
    """
    other = None if compare is None else (Path(compare), read_certificate(Path(compare)))
    sources = list_folders_with("tracks.csv", [Path(one) for one in inputs])
    folder = parse_output_path(out)
    require_writable_folder(folder)
    store = open_cache(cache)
    with open_executor() as executor:
        return certify_table(sources, other, folder, store, executor, on_activity)
