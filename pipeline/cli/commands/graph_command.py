"""`trueroll graph`: list the stages, which are cached, and why others are stale."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pipeline.chain import build_run_graph
from pipeline.engine.result_cache import open_cache
from pipeline.run_options import RunOptions, build_options, list_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings


@cli.command("graph")
@add_settings(list_settings(), build_options)
def graph(
    options: RunOptions,
    clip: Annotated[Path | None, typer.Argument()] = None,
    out: Annotated[Path | None, cli.OUT] = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """List the stages in order: which are cached, and why others are stale.

    Args:
        clip: The clip whose stages are listed.
        out: Draw the graph into an .svg or .png file.
    """
    from pipeline.engine.graph_drawing import write_graph_image
    from pipeline.engine.stage_graph import StageGraph, StageStatus

    if clip is None:
        stages = build_run_graph(Path(__file__), options).stages
        views = [StageStatus(s.name, s.needs, "waiting", "waits for a clip" if not s.needs else "") for s in stages]
    else:
        chain: StageGraph = build_run_graph(clip, options)
        views = chain.list_statuses(open_cache(cache))
    if out is not None:
        write_graph_image(views, out)
    if as_json:
        print(json.dumps([asdict(v) for v in views]))
        return
    if clip is None:
        cli.print_rows(("stage", "needs"), ((v.stage, ", ".join(v.needs)) for v in views))
        print(f"Drawn in {out}" if out is not None else "Name a clip to see what is cached: trueroll graph CLIP")
        return
    style = {"cached": "green", "stale": "yellow", "waiting": "dim"}
    rows = ((v.stage, ", ".join(v.needs), f"[{style[v.state]}]{v.state}[/]", v.why) for v in views)
    cli.print_rows(("stage", "needs", "state", "why"), rows)
    if out is not None:
        print(f"Drawn in {out}")
