"""trueroll batch: every clip below a folder."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table as Grid

from models.core.errors import OptionError
from pipeline.chain import refuse_closed
from pipeline.engine.atomic_write import clear_left
from pipeline.options import RunOptions
from pipeline.reporting.text.sentences import told
from pipeline.terminal.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    app,
    console,
    named,
    open_cache,
    standard_output,
    with_settings,
)

if TYPE_CHECKING:
    from pipeline.batch.batch_workers import Crew
    from pipeline.batch.clip_job import Row
    from pipeline.batch.run_batch import Batch

MOST_SHOWN = 100
"""Rows of the final table; of a larger batch those that failed."""


@app.command("batch")
@with_settings
def batch(
    folder: Annotated[Path, typer.Argument(help="Folder with clips, at any depth.")],
    options: RunOptions,
    out: Annotated[
        Path, typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder of the results.")
    ] = Path("out"),
    jobs: Annotated[int, typer.Option("--jobs", help="Clips at a time; 0: one per core.", min=0)] = 1,
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="tcp://HOST:PORT", help="A Dask scheduler to use."),
    ] = None,
    time_limit: Annotated[float, typer.Option("--time-limit", help="s that a clip or a shot of it may take.")] = 3600.0,
    memory_limit: Annotated[float, typer.Option("--memory-limit", help="MB of memory that a clip may take.")] = 4096.0,
    watch: Annotated[bool, typer.Option("--watch", help="Go on with clips that come; Ctrl-C ends it.")] = False,
    idle: Annotated[
        float | None, typer.Option("--idle", help="With --watch: s without a new clip after which to end.")
    ] = None,
    gaps: Annotated[bool, typer.Option("--diagnose", help="Then diagnose all shots of one table together.")] = False,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Every clip below a folder; one bad clip stops nothing; run again, it resumes."""
    from pipeline.batch.batch_display import BatchDisplay
    from pipeline.batch.clip_discovery import find_clips, largest_first
    from pipeline.batch.clip_job import Limits, settings_of
    from pipeline.batch.folder_watch import arriving
    from pipeline.batch.run_batch import Batch, run_batch

    if not folder.is_dir():
        raise OptionError(f"A folder with clips was expected; {folder} is none")
    if cluster is not None and jobs != 1:
        raise OptionError("--jobs is for this machine and --cluster for others; give one of them")
    if not (time_limit > 0 and memory_limit > 0 and (idle is None or idle > 0)):
        raise OptionError("--time-limit, --memory-limit and --idle are more than 0")
    clips = list(find_clips(folder, besides=out))
    if not clips and not watch:
        raise OptionError(f"A folder with clips was expected; {folder} holds none")
    refuse_closed(out)
    clear_left(out)
    store = open_cache(cache)
    store.clear_rubbish()
    work = Batch(folder, out, store, settings_of(options), Limits(time_limit, memory_limit))
    work.know(clips)
    queue = clips if jobs == 1 and cluster is None else largest_first(clips)
    try:
        with (
            _crew(work, jobs, cluster, clips) as crew,
            BatchDisplay(console, None if watch else len(clips)) as display,
        ):
            run_batch(work, arriving(folder, out, idle) if watch else queue, crew, display)
    except KeyboardInterrupt:
        if not watch:
            raise
    rows = work.ended
    _tell(rows, out, as_json)
    if gaps:
        _diagnose(rows, out)
    if any(row.status == "failed" for row in rows):
        raise typer.Exit(1)


@contextmanager
def _crew(work: Batch, jobs: int, cluster: str | None, clips: list[Path]) -> Iterator[Crew]:
    """Who runs the clips: one process, a cluster of this machine, or one that exists."""
    from pipeline.batch.batch_workers import by_workers, one_after_another

    if cluster is None and jobs == 1:
        yield one_after_another
        return
    if cluster is None:
        from pipeline.batch import clip_processes

        count = jobs or os.cpu_count() or 1
        try:
            clip_processes.begin(min(count, len(clips)))  # before Dask, which is slow to import
            from pipeline.batch.dask_cluster import local_client

            with local_client(count) as client:
                yield partial(by_workers, client)
        finally:
            clip_processes.end_all()
        return
    from pipeline.batch.dask_cluster import check_workers, remote_client

    with remote_client(cluster) as client:
        check_workers(client, work.cache, work.out, clips[0] if clips else work.root)
        yield partial(by_workers, client)


def _diagnose(rows: list[Row], out: Path) -> None:
    """Say of each table what its shots together say."""
    from pipeline.actions.diagnose_batch import diagnose_tables, tables_of

    for table, sentence in diagnose_tables(tables_of(rows), out, console):
        shots = f"{len(table.folders)} shot{'s' * (len(table.folders) != 1)}"
        console.print(f"{table.name} ({shots}): {sentence}", markup=False, soft_wrap=True)


def _tell(rows: list[Row], out: Path, as_json: bool) -> None:
    """A line per clip, and what there is to look at."""
    if as_json:
        print(json.dumps([asdict(row) for row in rows]))
        return
    shown = rows if len(rows) <= MOST_SHOWN else [row for row in rows if row.status == "failed"]
    grid = Grid("clip", "trust", "contacts", "look at", box=None, pad_edge=False)
    for row in shown:
        look = row.sentence or told(f"{row.folder}/{'shot-*/' if row.in_shots else ''}report.html")
        grid.add_row(escape(row.clip), row.trust or row.status, str(row.contacts), escape(look))
    standard_output().print(grid)
    done = sum(row.status == "done" for row in rows)
    print(f"{done} of {len(rows)} clips done; {out / 'summary.csv'} lists them, {out / 'summary.html'} shows them.")
