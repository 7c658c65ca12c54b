"""`trueroll app`: one page in the browser for everything."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pipeline.engine.result_cache import CACHE_VARIABLE
from pipeline.terminal import command_line as cli


@cli.command("app")
def app(
    library: Annotated[Path, typer.Option(metavar="DIR")] = Path("out"),
    port: Annotated[int, typer.Option(min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser")] = True,
    lan: bool = False,
    cache: cli.CacheOption = None,
) -> None:
    """Open a page in the browser: drop clips, watch them run, ask, correct and compare shots.

    Args:
        library: Folder of the shots; the results of run and batch are shots too.
        port: Port of the page; 0 takes a free one.
        browser: Open the page in the browser.
        lan: Let a phone in the same network open the page, with a code that the page shows.
    """
    from pipeline.app.app_server import open_page
    from pipeline.app.shot_library import ShotLibrary

    if cache is not None:
        os.environ[CACHE_VARIABLE] = str(cache.absolute())  # also for the processes that the page starts
    open_page(ShotLibrary(library), port, browser=browser, lan=lan)
