"""trueroll graph: the stages, what is cached, what is stale and why."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table as Grid

from pipeline.chain import run_graph
from pipeline.options import RunOptions
from pipeline.terminal.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    app,
    named,
    open_cache,
    standard_output,
    with_settings,
)


@app.command("graph")
@with_settings
def graph(
    options: RunOptions,
    clip: Annotated[Path | None, typer.Argument(help="The clip whose stages are looked at.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", parser=named, metavar="PATH", help="Draw it into an .svg or .png file."),
    ] = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The stages in order: what is cached, what is stale and why."""
    from pipeline.engine.graph_drawing import write_picture
    from pipeline.engine.stage_graph import Graph, Outlook

    if clip is None:
        stages = run_graph(Path(__file__), options).stages
        views = [Outlook(s.name, s.needs, "waiting", "waits for a clip" if not s.needs else "") for s in stages]
    else:
        chain: Graph = run_graph(clip, options)
        views = chain.outlook(open_cache(cache))
    if out is not None:
        write_picture(views, out)
    if as_json:
        print(json.dumps([asdict(v) for v in views]))
        return
    if clip is None:
        grid = Grid("stage", "needs", box=None, pad_edge=False)
        for v in views:
            grid.add_row(v.stage, ", ".join(v.needs))
        standard_output().print(grid)
        print(f"Drawn in {out}" if out is not None else "Name a clip to see what is cached: trueroll graph CLIP")
        return
    grid = Grid("stage", "needs", "state", "why", box=None, pad_edge=False)
    style = {"cached": "green", "stale": "yellow", "waiting": "dim"}
    for v in views:
        grid.add_row(v.stage, ", ".join(v.needs), f"[{style[v.state]}]{v.state}[/]", v.why)
    standard_output().print(grid)
    if out is not None:
        print(f"Drawn in {out}")
