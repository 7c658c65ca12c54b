"""`trueroll edit`: correct a run by hand in the browser."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pipeline.engine.result_cache import CACHE_VARIABLE
from pipeline.terminal import command_line as cli


@cli.command("edit")
def edit(
    target: Annotated[Path, typer.Argument(metavar="DIR|CLIP")],
    port: Annotated[int, typer.Option(min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser")] = True,
    cache: cli.CacheOption = None,
) -> None:
    """Correct a run by hand on the page of trueroll app, without code; later runs of the clip honour the corrections.

    Of a rally: hits, bounces, touches of the net, landings (frames), places of the object (px), corners (px) and sport.
    The options of the run need not be given again; corrections beat them.

    Args:
        target: Folder of a run, or a clip, which is run first, into out/<clip>.
        port: Port of the page; 0 takes a free one.
        browser: Open the page in the browser.
    """
    from pipeline.app.app_server import open_page
    from pipeline.app.job_queue import JobQueue
    from pipeline.app.shot_library import ShotLibrary
    from pipeline.editing.edited_clip import find_edited_clip  # slow to import

    if cache is not None:
        os.environ[CACHE_VARIABLE] = str(cache.absolute())  # also for the processes that the page starts
    edited = find_edited_clip(target)
    library = ShotLibrary(edited.folder.parent, depth=1)
    is_new = edited.path == target and library.read_clip(edited.folder) != target.absolute()
    if is_new:
        JobQueue(library).add_clip(target.absolute())
    open_page(library, port, browser=browser, shot=None if is_new else edited.folder)
