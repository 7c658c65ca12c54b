"""trueroll view: the recording of a run in the rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from models.errors import OptionError
from pipeline.chain import default_folder, run_clip
from pipeline.command_line import CacheOption, DebugOption, app, console, open_cache
from pipeline.display import StageDisplay
from pipeline.options import RunOptions


@app.command("view")
def view(
    target: Annotated[Path, typer.Argument(metavar="CLIP|DIR", help="A run's folder, or a clip to run first.")],
    web: Annotated[bool, typer.Option("--web", help="In the browser instead of the native viewer.")] = False,
    cache: CacheOption = None,
    debug: DebugOption = False,
) -> None:
    """The recording of a run in the rerun viewer."""
    from pipeline.viewer import WEB_ADDRESS, show_recording

    if target.is_dir() or target.suffix == ".rrd":
        recording = target / "recording.rrd" if target.is_dir() else target
        if not recording.is_file():
            raise OptionError(f"A recording was expected; {recording} is none. Run the clip first: trueroll run CLIP")
    else:
        folder = default_folder(target)
        with StageDisplay(console, str(target)) as display:
            run_clip(target, folder, RunOptions(), open_cache(cache), display)
        recording = folder / "recording.rrd"
    if web:
        print(f"Look at {WEB_ADDRESS} (end with Ctrl-C)", flush=True)
    raise typer.Exit(show_recording(recording, web=web))
