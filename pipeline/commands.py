"""The commands: trueroll run, batch, view, graph, cache."""

from __future__ import annotations

import inspect
import json
import math
import sys
import traceback
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from models.errors import OptionError
from pipeline.cache import Cache, default_root
from pipeline.chain import Run, default_folder, refuse_closed, run_clip, run_graph
from pipeline.display import StageDisplay
from pipeline.options import RunOptions, collect, parameters
from pipeline.sentences import event_sentence, event_time, one_sentence

app = typer.Typer(
    help="A clip of a billiards shot goes in; physics-true annotated slow motion comes out.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
console = Console(stderr=True, highlight=False)

UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""Of the click that this typer uses: its own or the package."""

ClipArgument = Annotated[Path, typer.Argument(help="A clip of a shot: mp4, mov, mkv, avi, webm.")]


def _named(text: str | Path) -> Path:
    """A path that is not empty: an empty one would mean the folder one is in."""
    if not str(text).strip():
        raise OptionError("-o, --out needs a name; an empty one was given")
    return Path(text)


OutOption = Annotated[
    Path | None,
    typer.Option(
        "-o", "--out", parser=_named, metavar="PATH", help="Folder of the results; out/<clip> where not given."
    ),
]
CacheOption = Annotated[
    Path | None, typer.Option("--cache", help="Cache folder; $TRUEROLL_CACHE, else ~/.cache/trueroll where not given.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show where an error comes from.")]


def _open_cache(folder: Path | None) -> Cache:
    root = folder if folder is not None else default_root()
    try:
        return Cache(root)
    except OSError as error:
        raise OptionError(f"The cache needs a folder that can be written; {root}: {error.strerror}") from error


def _version(wanted: bool) -> None:
    if wanted:
        print(f"trueroll {version('trueroll')}")
        raise typer.Exit


@app.callback()
def _common(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    return None


def _with_settings(function: Callable[..., None]) -> Callable[..., None]:
    """The command with the option of every stage appended, as one `options` argument."""
    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "options"]
    names = {p.name for p in own}
    extra = parameters()

    def command(**values: Any) -> None:
        options = collect({p.name: values[p.name] for p in extra})
        function(**{name: values[name] for name in names}, options=options)

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + extra
    )
    command.__annotations__ = {p.name: p.annotation for p in [*own, *extra]}
    command.__doc__ = function.__doc__
    return command


def run(
    clip: ClipArgument,
    options: RunOptions,
    out: OutOption = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """A clip to annotated slow motion, tracks, contacts and a fitted model."""
    folder = out if out is not None else default_folder(clip)
    with StageDisplay(console, str(clip)) as display:
        made = run_clip(clip, folder, options, _open_cache(cache), display)
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
    trust = {"light": made.trust.light, "why": list(made.trust.reasons)}
    return {"folder": str(made.folder), "trust": trust, "events": rows}


def _tell(made: Run) -> None:
    """What happened, how far to trust it, and where to look."""
    screen = Console(highlight=False)
    if len(made.events):
        grid = Grid("time", "what", "probability", box=None, pad_edge=False)
        for k in range(len(made.events)):
            grid.add_row(
                event_time(made.events, k), event_sentence(made.events, k), f"{made.events.probability[k]:.0%}"
            )
        screen.print(grid)
    else:
        screen.print("Nothing moves in this clip.")
    light = {"green": "green", "amber": "yellow", "red": "red"}[made.trust.light]
    screen.print(f"[{light}]●[/] trust: {made.trust.light}. " + escape(" ".join(made.trust.reasons)))
    print(f"Look at {made.folder / 'slow.mp4'} and {made.folder / 'report.html'}")


def batch(
    folder: Annotated[Path, typer.Argument(help="Folder with clips, at any depth.")],
    options: RunOptions,
    out: Annotated[
        Path, typer.Option("-o", "--out", parser=_named, metavar="PATH", help="Folder of the results.")
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
    store = _open_cache(cache)
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


@app.command()
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
            run_clip(target, folder, RunOptions(), _open_cache(cache), display)
        recording = folder / "recording.rrd"
    if web:
        print(f"Look at {WEB_ADDRESS} (end with Ctrl-C)", flush=True)
    raise typer.Exit(show_recording(recording, web=web))


def graph(
    options: RunOptions,
    clip: Annotated[Path | None, typer.Argument(help="The clip whose stages are looked at.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", parser=_named, metavar="PATH", help="Draw it into an .svg or .png file."),
    ] = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The stages in order: what is cached, what is stale and why."""
    from pipeline.graph import Graph, Outlook
    from pipeline.picture import write_picture

    if clip is None:
        stages = run_graph(Path(__file__), options).stages
        views = [Outlook(s.name, s.needs, "waiting", "waits for a clip" if not s.needs else "") for s in stages]
    else:
        chain: Graph = run_graph(clip, options)
        views = chain.outlook(_open_cache(cache))
    if out is not None:
        write_picture(views, out)
    if as_json:
        print(json.dumps([asdict(v) for v in views]))
        return
    if clip is None:
        grid = Grid("stage", "needs", box=None, pad_edge=False)
        for v in views:
            grid.add_row(v.stage, ", ".join(v.needs))
        Console(highlight=False).print(grid)
        print(f"Drawn in {out}" if out is not None else "Name a clip to see what is cached: trueroll graph CLIP")
        return
    grid = Grid("stage", "needs", "state", "why", box=None, pad_edge=False)
    style = {"cached": "green", "stale": "yellow", "waiting": "dim"}
    for v in views:
        grid.add_row(v.stage, ", ".join(v.needs), f"[{style[v.state]}]{v.state}[/]", v.why)
    Console(highlight=False).print(grid)
    if out is not None:
        print(f"Drawn in {out}")


@app.command("cache")
def show_cache(
    prune: Annotated[bool, typer.Option("--prune", help="Remove entries by age or until the rest fits.")] = False,
    older_than: Annotated[float | None, typer.Option("--older-than", help="Age in days since the last use.")] = None,
    max_size: Annotated[float | None, typer.Option("--max-size", help="Largest size to keep, in MB.")] = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """List, size and prune the cache."""
    store = _open_cache(cache)
    if prune:
        if older_than is None and max_size is None:
            raise OptionError("Pruning needs to know what to remove: give --older-than DAYS or --max-size MB")
        for flag, value, unit in (("--older-than", older_than, "days"), ("--max-size", max_size, "MB")):
            if value is not None and not 0 <= value < math.inf:
                raise OptionError(f"{flag} is a number of {unit} that is 0 or more; got {value:g}")
        removed = store.prune(
            older_than_s=None if older_than is None else 86400 * older_than,
            largest_bytes=None if max_size is None else round(1e6 * max_size),
        )
        print(f"Removed {len(removed)} entries, {sum(entry.size for entry in removed) / 1e6:.1f} MB")
    entries = list(store.entries())
    if as_json:
        print(json.dumps([{"stage": e.stage, "key": e.key, "size": e.size, "used": e.used} for e in entries]))
        return
    grid = Grid("stage", "entries", "MB", "made in s", box=None, pad_edge=False)
    for stage in sorted({entry.stage for entry in entries}):
        rows = [entry for entry in entries if entry.stage == stage]
        size, seconds = sum(e.size for e in rows) / 1e6, sum(e.seconds for e in rows)
        grid.add_row(stage, str(len(rows)), f"{size:.1f}", f"{seconds:.1f}")
    Console(highlight=False).print(grid)
    print(f"{len(entries)} entries, {sum(entry.size for entry in entries) / 1e6:.1f} MB in {store.root}")


for _name, _command in (("run", run), ("batch", batch), ("graph", graph)):
    app.command(_name)(_with_settings(_command))


def execute(arguments: list[str]) -> int:
    """Run one command line; the exit status: 0 all went well, 1 some of it failed, 2 wrong usage."""
    try:
        status = app(arguments or ["--help"], standalone_mode=False) or 0
        sys.stdout.flush()
    except Exception as error:
        status = _fail(error, "--debug" in arguments)
    return int(status)


def _fail(error: Exception, debug: bool) -> int:
    """Say in one line what went wrong; the exit status."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, UsageError):
        print(f"trueroll: {_usage(error)}", file=sys.stderr)
        return 2
    print(f"trueroll: {one_sentence(error)}", file=sys.stderr)
    return 2 if isinstance(error, OptionError) else 1


def _usage(error: Any) -> str:
    context = error.ctx.command_path if error.ctx else "trueroll"
    return f"{' '.join(error.format_message().split()).rstrip('.')}; see {context} --help"
