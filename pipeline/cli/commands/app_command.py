"""`trueroll app`: one page in the browser for everything."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from pipeline.engine.atomic_write import require_writable_folder
from pipeline.terminal import command_line as cli


@cli.command("app")
def app(
    library: Annotated[Path, typer.Option(metavar="DIR")] = Path("out"),
    port: Annotated[int, typer.Option(min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser")] = True,
    lan: bool = False,
) -> None:
    """Open a page in the browser: drop clips, watch them run, ask, correct and compare shots.

    Args:
        library: Folder of the shots; the results of run and batch are shots too.
        port: Port of the page; 0 takes a free one.
        browser: Open the page in the browser.
        lan: Let a phone in the same network open the page, with a code that the page shows.
    """
    from pipeline.app.app_server import AppServer
    from pipeline.app.shot_library import ShotLibrary

    require_writable_folder(library)
    server = AppServer(ShotLibrary(library), port, lan=lan)
    cli.print_note(f"The page is at {server.url} (end with Ctrl-C)")
    if browser:
        webbrowser.open(server.url)
    with suppress(KeyboardInterrupt):  # the way to end it
        server.run()
