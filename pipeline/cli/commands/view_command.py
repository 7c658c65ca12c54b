"""`trueroll view`: show the recording of a run (.rrd) in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.chain import default_run_folder, run_clip
from pipeline.engine.result_cache import open_cache
from pipeline.run_options import RunOptions
from pipeline.terminal import command_line as cli
from pipeline.terminal.progress_display import StageDisplay


@cli.command("view")
def view(
    target: Annotated[Path, typer.Argument(metavar="CLIP|DIR")],
    web: bool = False,
    cache: cli.CacheOption = None,
) -> None:
    """Show the recording (.rrd) of a run, or of every run of a batch, in the Rerun viewer.

    Args:
        target: Folder of a run or of a batch, an .rrd file, or a clip to run first.
        web: Use the browser instead of the native viewer.
    """
    from pipeline.reporting.recording.rerun_viewer import find_recordings, show_recordings

    shown = target
    if not target.is_dir() and target.suffix != ".rrd":
        shown = default_run_folder(target)
        with StageDisplay(cli.console, str(target)) as display:
            run_clip(target, shown, RunOptions(), open_cache(cache), display)
    raise typer.Exit(show_recordings(find_recordings(shown), web=web))
