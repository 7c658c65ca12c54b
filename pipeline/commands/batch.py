"""trueroll batch: every clip below a folder."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from models.errors import OptionError
from pipeline.chain import refuse_closed
from pipeline.command_line import CacheOption, DebugOption, JsonOption, app, console, named, open_cache, with_settings
from pipeline.display import StageDisplay
from pipeline.options import RunOptions


@app.command("batch")
@with_settings
def batch(
    folder: Annotated[Path, typer.Argument(help="Folder with clips, at any depth.")],
    options: RunOptions,
    out: Annotated[
        Path, typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder of the results.")
    ] = Path("out"),
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Every clip below a folder; one bad clip stops nothing; run again, it resumes."""
    from pipeline.batch import find_clips, run_batch

    if not folder.is_dir():
        raise OptionError(f"A folder with clips was expected; {folder} is none")
    clips = [clip for clip in find_clips(folder) if not clip.resolve().is_relative_to(out.resolve())]
    if not clips:
        raise OptionError(f"A folder with clips was expected; {folder} holds none")
    refuse_closed(out)
    store = open_cache(cache)
    with StageDisplay(console) as display:
        rows = run_batch(clips, folder, out, options, store, lambda clip: display.of(clip.name))
    failed = [row for row in rows if row.status == "failed"]
    if as_json:
        print(json.dumps([asdict(row) for row in rows]))
    else:
        grid = Grid("clip", "trust", "contacts", "look at", box=None, pad_edge=False)
        for row in rows:
            grid.add_row(
                escape(row.clip),
                row.trust or row.status,
                str(row.contacts),
                escape(row.sentence or f"{row.folder}/report.html"),
            )
        Console(highlight=False).print(grid)
        print(f"{len(rows) - len(failed)} of {len(rows)} clips done; {out / 'summary.csv'} lists them.")
    if failed:
        raise typer.Exit(1)
