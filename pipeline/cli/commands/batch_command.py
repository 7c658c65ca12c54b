"""trueroll batch: every clip below a folder."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from models.core.errors import OptionError
from pipeline.batch.clip_job import format_duration
from pipeline.engine.atomic_write import remove_leftovers, require_writable_folder
from pipeline.engine.process_setup import available_cores
from pipeline.engine.result_cache import open_cache
from pipeline.reporting.text.text_formatting import escape_text
from pipeline.run_options import RunOptions, build_options, list_setting_values, list_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings

if TYPE_CHECKING:
    from pipeline.batch.clip_discovery import FolderContent
    from pipeline.batch.clip_job import ClipResult, ClipRunner
    from pipeline.batch.run_batch import Batch


# Most files without video that are named.
MAX_NAMES = 5
# Most rows of the final table; for a larger batch it lists only failed clips.
MAX_TABLE_ROWS = 100


@cli.command("batch")
@add_settings(list_settings(), build_options)
def batch(
    folder: Path,
    options: RunOptions,
    out: Annotated[Path, cli.OUT] = Path("out"),
    jobs: Annotated[int, typer.Option(min=0)] = 1,
    cluster: Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT")] = None,
    time_limit: float = 3600.0,
    memory_limit: float = 4096.0,
    watch: bool = False,
    idle: float | None = None,
    gaps: Annotated[bool, typer.Option("--diagnose")] = False,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Run every clip below a folder; a bad clip does not stop the others, and a second call resumes.

    Args:
        folder: Folder with clips, at any depth; or one recording with many shots.
        out: Folder of the results.
        jobs: Number of clips that run at a time; 0: one per core.
        cluster: Address of a Dask scheduler whose workers run the clips.
        time_limit: Longest time for a clip, or for each shot of a long recording, in s.
        memory_limit: Most memory for a clip, in MB.
        watch: Keep running, and run new clips when they appear; Ctrl-C ends it.
        idle: With --watch: time without a new clip after which to end, in s.
        gaps: Finally diagnose all shots of each table together.
    """
    from pipeline.batch.clip_discovery import FolderContent, order_largest_first, survey_folder, watch_folder
    from pipeline.batch.clip_job import ClipLimits
    from pipeline.batch.run_batch import Batch, run_batch

    began = time.monotonic()
    recording = folder if folder.is_file() else None
    folder = folder if recording is None else folder.parent
    if not folder.is_dir():
        raise OptionError(f"A folder with clips, or a recording, was expected; {folder} is neither")
    if recording is not None and watch:
        raise OptionError(f"--watch follows a folder; {recording} is a file")
    if cluster is not None and jobs != 1:
        raise OptionError("--jobs is for this machine and --cluster for others; give one of them")
    if not (time_limit > 0 and memory_limit > 0 and (idle is None or idle > 0)):
        raise OptionError("--time-limit, --memory-limit and --idle are more than 0")
    content = FolderContent((recording,), ()) if recording is not None else survey_folder(folder, excluded=out)
    clips = list(content.clips)
    _print_left_out(content, folder)
    if not clips and not watch:
        raise OptionError(f"A folder with clips was expected; {folder} holds none")
    require_writable_folder(out)
    remove_leftovers(out)
    store = open_cache(cache)
    store.remove_leftovers()
    work = Batch(folder, out, store, list_setting_values(options), ClipLimits(time_limit, memory_limit))
    work.assign_folders(clips)
    if not as_json:
        _print_disk_use(work, options)
    queue = clips if jobs == 1 and cluster is None else order_largest_first(clips)
    try:
        with (
            _open_runner(work, jobs, cluster, clips) as runner,
            BatchDisplay(cli.console, None if watch else len(clips)) as display,
        ):
            run_batch(work, watch_folder(folder, out, idle) if watch else queue, runner, display)
    except KeyboardInterrupt:
        if not watch:
            raise
    rows = work.results
    _print_results(rows, out, time.monotonic() - began, as_json)
    if gaps:
        from pipeline.actions.diagnose_batch import diagnose_tables, group_by_table

        for table, sentence in diagnose_tables(group_by_table(rows), out, cli.console):
            shots = f"{len(table.folders)} shot{'s' * (len(table.folders) != 1)}"
            cli.print_note(f"{table.name} ({shots}): {sentence}")
    if any(row.status == "failed" for row in rows):
        raise typer.Exit(1)


@contextmanager
def _open_runner(work: Batch, jobs: int, cluster: str | None, clips: list[Path]) -> Iterator[ClipRunner]:
    """Open what runs the clips: processes on this machine, or an existing cluster."""
    from pipeline.batch import supervision

    if cluster is None:
        try:
            yield partial(supervision.run_on_processes, jobs or available_cores())
        finally:
            supervision.end_processes()
        return
    from pipeline.batch.dask_cluster import connect_client, require_usable_workers, run_on_workers

    with connect_client(cluster) as client:
        require_usable_workers(client, work.cache, work.out, clips[0] if clips else work.root)
        yield partial(run_on_workers, client)


def _print_left_out(content: FolderContent, folder: Path) -> None:
    """Print which files are not run, and why."""
    others = [str(one.path.relative_to(folder)) for one in content.left_out if one.original is None]
    lines = [
        f"{one.path.relative_to(folder)}: a smaller copy of {one.original.name}"
        for one in content.left_out
        if one.original is not None
    ]
    if others:
        more = f" and {len(others) - MAX_NAMES} more" if len(others) > MAX_NAMES else ""
        lines.append(f"{', '.join(others[:MAX_NAMES])}{more}: no video")
    for line in lines:
        cli.print_note(f"Left out: {escape_text(line)}")


def _print_disk_use(work: Batch, options: RunOptions) -> None:
    """Print what the batch will write, before it does; of long recordings it is known once their shots are found."""
    from pipeline.batch.clip_discovery import FilmLength, describe_room, estimate_bytes, measure_film
    from video.calibration.shot_segmentation import LONG_RECORDING_S

    facts = {folder: measure_film(clip) for clip, folder in work.folders.items()}
    films = [
        FilmLength(folder, one.pixels, one.frames) for folder, one in facts.items() if one.seconds < LONG_RECORDING_S
    ]
    if films:
        text = describe_room(estimate_bytes(films, options.render), work.out, work.cache.root)
        others = len(facts) - len(films)
        later = f"; {others} long recording{'s' * (others != 1)} not counted yet" if others else ""
        cli.print_note(f"Disk: {text}{later}")


def _print_results(rows: list[ClipResult], out: Path, seconds: float, as_json: bool) -> None:
    """Print a line per clip, the paths of the results, and what the batch spent its time on."""
    if as_json:
        print(json.dumps([asdict(row) for row in rows]))
        return
    shown = rows if len(rows) <= MAX_TABLE_ROWS else [row for row in rows if row.status == "failed"]
    cells = []
    for row in shown:
        remark = row.sentence or escape_text(f"{row.folder}/{'shot-*/' if row.in_shots else ''}report.html")
        cells.append((escape(row.clip), row.trust or row.status, str(row.contacts), escape(remark)))
    cli.print_rows(("clip", "trust", "contacts", "look at"), cells)
    done = sum(row.status == "done" for row in rows)
    print(f"{done} of {len(rows)} clips done; {out / 'summary.csv'} lists them, {out / 'summary.html'} shows them.")
    print(_describe_duration(rows, seconds))


def _describe_duration(rows: list[ClipResult], seconds: float) -> str:
    """Describe what a batch spent its time (s) on.

    Clips run side by side, so their shares of the time are those of the sum over clips.
    """
    total = sum(row.seconds for row in rows)
    compiling = seconds * sum(row.compiling for row in rows) / total if total else 0.0
    processing = f"Processing took {format_duration(seconds - compiling)}"
    if compiling < 1:
        return f"{processing}."
    return f"{processing}, and compiling numerical code about {format_duration(compiling)}: once on this machine."


# s below which a clip or a shot came from the cache, so that it does not count for the time left.
CACHED_S = 1.0


class RemainingTime:
    """An estimate of the time that is left, from how long the work took that did not come from the cache."""

    def __init__(self, now: float) -> None:
        self._at, self._share = now, 0.0
        self._worked_s = self._worked_share = 0.0

    def describe(self, share: float, now: float) -> str:
        """Say how much time is left when a share of the work is done; empty while that is not known."""
        seconds, done = now - self._at, share - self._share
        self._at, self._share = now, share
        if seconds >= CACHED_S:
            self._worked_s, self._worked_share = self._worked_s + seconds, self._worked_share + done
        if self._worked_share <= 0:
            self._worked_s = 0.0  # the search for shots
            return ""
        return f"about {format_duration((1 - share) * self._worked_s / self._worked_share)} left"


# Most characters of a clip's name that are shown.
NAME_WIDTH = 32
# Redraws per second. Clips report half as often, and each redraw takes time from workers on the same machine.
REFRESH_HZ = 4


class BatchDisplay:
    """A follower of a batch with progress bars, as a context manager. It draws nothing unless on a terminal."""

    def __init__(self, console: Console, expected: int | None) -> None:
        columns = (
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )  # fmt: skip
        self._bars = Progress(*columns, console=console, disable=not console.is_terminal, refresh_per_second=REFRESH_HZ)
        self._all = self._bars.add_task("clips", total=expected, note="")
        self._clips: dict[str, TaskID] = {}
        self._count = [0, 0]
        self._remaining = RemainingTime(time.monotonic())
        self._remaining_shots: dict[str, RemainingTime] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for task in self._clips.values():
            self._bars.remove_task(task)
        self._bars.stop()

    def show_progress(self, clip: str, message: dict[str, Any]) -> None:
        """Show the progress of a clip; see `clip_runner` for the messages."""
        if "note" in message:
            self._bars.console.print(escape_text(message["note"]), markup=False, soft_wrap=True)
        if self._bars.disable:
            return
        if clip not in self._clips:
            name = clip if len(clip) <= NAME_WIDTH else f"…{clip[1 - NAME_WIDTH :]}"
            self._clips[clip] = self._bars.add_task(f"  {escape(name)}", total=100, note="")
        if "shot" in message:
            now = time.monotonic()
            left = self._remaining_shots.setdefault(clip, RemainingTime(now)).describe(message["done"], now)
            note = ", ".join(filter(None, ["shot {} of {}".format(*message["shot"]), left]))
            self._bars.update(self._clips[clip], completed=round(100 * message["done"]), note=note)
        elif "stage" in message and clip in self._remaining_shots:
            pass  # the bar counts shots
        elif "stage" in message:
            self._bars.update(self._clips[clip], completed=round(100 * message["share"]), note=message["stage"])

    def show_result(self, row: ClipResult, expected: int) -> None:
        """Count a clip that has ended, and remove its line."""
        task = self._clips.pop(row.clip, None)
        if task is not None:
            self._bars.remove_task(task)
        self._count[row.status == "failed"] += 1
        failed = f"{self._count[1]} failed" if self._count[1] else ""
        left = self._remaining.describe(sum(self._count) / expected, time.monotonic())
        note = ", ".join(filter(None, [failed, left if sum(self._count) < expected else ""]))
        self._bars.update(self._all, completed=sum(self._count), total=expected, note=note)
