"""`trueroll edit`: correct a run by hand in the browser."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from pipeline.engine.result_cache import open_cache
from pipeline.run_options import RunOptions, build_options, list_overridden_flags, list_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings


@cli.command("edit")
@add_settings(list_settings(), build_options)
def edit(
    target: Annotated[Path, typer.Argument(metavar="DIR|CLIP")],
    options: RunOptions,
    out: Annotated[Path | None, cli.OUT] = None,
    port: Annotated[int, typer.Option(min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser")] = True,
    cache: cli.CacheOption = None,
) -> None:
    """Correct a run by hand on a page in the browser, without code; later runs of the clip honour the corrections.

    The options of the run need not be given again; corrections beat the options that are given.

    Args:
        target: Folder of a run, or a clip to run first.
        out: Folder of the results. Default: out/<clip>.
        port: Port of the page; 0 takes a free one.
        browser: Open the page in the browser.
    """
    from pipeline.editing.edit_server import EditServer  # slow to import
    from pipeline.editing.edit_session import EditSession
    from pipeline.editing.edited_clip import continue_run_options, find_edited_clip
    from pipeline.io.corrections_file import corrections_path, read_corrections

    edited = find_edited_clip(target, out)
    if overridden := list_overridden_flags(options, read_corrections(edited.path, edited.digest).corrections):
        path = corrections_path(edited.path)
        note = f"Note: {', '.join(overridden)} is not used, because {path} sets it; correct it on the page"
        cli.print_note(note)
    session = EditSession(edited, continue_run_options(edited, options), open_cache(cache))
    try:
        server = EditServer(session, port)
        cli.print_note(f"Correct the run at {server.url} (end with Ctrl-C)")
        if browser:
            webbrowser.open(server.url)
        with suppress(KeyboardInterrupt):  # the way to end it
            server.run()
    finally:
        session.close()
