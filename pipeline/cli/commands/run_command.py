"""trueroll run: one clip to the folder of its results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table as Grid

from pipeline.chain import Run, default_folder, run_clip
from pipeline.engine.result_cache import Cache
from pipeline.options import RunOptions
from pipeline.reporting.text.run_trust import trust_facts, trust_line
from pipeline.reporting.text.sentences import event_sentence, event_time
from pipeline.terminal.command_line import (
    CacheOption,
    ClipArgument,
    DebugOption,
    JsonOption,
    OutOption,
    app,
    console,
    open_cache,
    standard_output,
    with_settings,
)
from pipeline.terminal.progress_display import StageDisplay


@app.command("run")
@with_settings
def run(
    clip: ClipArgument,
    options: RunOptions,
    out: OutOption = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="Watch it come in: in the rerun viewer, or the browser where there is no display."),
    ] = False,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """A clip to annotated slow motion, tracks, contacts and a fitted model."""
    folder = out if out is not None else default_folder(clip)
    store = open_cache(cache)
    if live:
        _run_live(clip, folder, options, store, as_json)
        return
    with StageDisplay(console, str(clip)) as display:
        made = run_clip(clip, folder, options, store, display)
    _say(made, as_json)


def _run_live(clip: Path, folder: Path, options: RunOptions, cache: Cache, as_json: bool) -> None:
    """Run in front of a viewer, and wait until it is closed."""
    from pipeline.reporting.recording.live_recording import LiveRecording, LiveWatcher
    from pipeline.reporting.recording.rerun_viewer import has_display, open_viewer

    with open_viewer([], web=not has_display()) as viewer:
        if viewer.address:
            console.print(f"Look at {viewer.address} (end with Ctrl-C)", markup=False, soft_wrap=True)
        recording = LiveRecording(viewer.listens, clip.name)
        with StageDisplay(console, str(clip)) as display:
            made = run_clip(clip, folder, options, cache, LiveWatcher(display, recording), recording.made)
        recording.close()
        _say(made, as_json)
        viewer.process.wait()


def _say(made: Run, as_json: bool) -> None:
    for note in made.notes:
        console.print(f"Note: {note}", markup=False, soft_wrap=True)
    if as_json:
        print(json.dumps(_as_json(made), allow_nan=False))
    else:
        _tell(made)


def _as_json(made: Run) -> dict[str, Any]:
    events = made.events
    names = ("kind", "t", "t_sigma", "a", "b", "probability")
    rows = [{name: getattr(events, name)[k] for name in names} for k in range(len(events))]
    return {"folder": str(made.folder), "trust": trust_facts(made.trust), "events": rows}


def _tell(made: Run) -> None:
    """What happened, how far to trust it, and where to look."""
    screen = standard_output()
    if len(made.events):
        grid = Grid("time", "what", "probability", box=None, pad_edge=False)
        for k in range(len(made.events)):
            grid.add_row(
                event_time(made.events, k), event_sentence(made.events, k), f"{made.events.probability[k]:.0%}"
            )
        screen.print(grid)
    else:
        screen.print("Nothing moves in this clip.")
    screen.print(trust_line(made.trust))
    print(f"Look at {made.folder / 'slow.mp4'} and {made.folder / 'report.html'}")
