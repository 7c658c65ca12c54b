"""trueroll gapcheck: the blind check of the diagnosis."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table as Grid

from models.core.errors import OptionError
from models.numerics.executor import Crew
from pipeline.engine.helper_process import crew
from pipeline.terminal.command_line import DebugOption, JsonOption, app, console, standard_output


@app.command("gapcheck")
def gapcheck(
    only: Annotated[str, typer.Option("--only", help="Only kinds of case whose name holds this word.")] = "",
    every: Annotated[bool, typer.Option("--all", help="All kinds of billiards, not one of each question.")] = False,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Cases of each kind.")] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the first case of each kind.")] = 0,
    shots: Annotated[int, typer.Option("--shots", min=5, help="Shots of a case.")] = 12,
    fps: Annotated[float, typer.Option("--fps", min=5, help="Pictures a second.")] = 60.0,
    real: Annotated[
        Path | None, typer.Option("--real", metavar="DIR", help="Folder of measurements to check as well.")
    ] = None,
    keep: Annotated[Path | None, typer.Option("--keep", help="Folder for the track folders and their reports.")] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The blind check of `diagnose`: worlds that withhold an effect, and measurements whose effect is known.

    A world plays as a process of its own and writes a track folder; which effect it withheld is sealed until the report
    is written. Prints who was found, false alarms, unknowns, the closed part of the gap, and calibration.

    On two idle cores this takes some six minutes; `--all` about twenty, for a table takes half a minute. Bodies that
    slide, fly and swing take three together (`--only slide`, `flight` or `pendulum`).
    """
    from pipeline.experiments.gapcheck.blind_case import judge, play
    from pipeline.experiments.gapcheck.case_catalogue import KINDS, USUAL
    from pipeline.experiments.gapcheck.case_scores import marks_of

    asked = [kind for kind in (KINDS if only or every else USUAL) if only in kind.name]
    if not asked and real is None:
        raise OptionError(f"--only {only!r} fits no kind of case; there are {'; '.join(kind.name for kind in KINDS)}")
    kinds = [kind for kind in asked if not kind.engine or find_spec(kind.engine)]
    if lacking := sorted({kind.engine for kind in asked} - {kind.engine for kind in kinds}):
        console.print(
            f"{len(asked) - len(kinds)} kinds are left out, for their worlds need {', '.join(lacking)}; install"
            " trueroll with the extra check: .[check]",
            markup=False,
        )
    with TemporaryDirectory() as scratch:
        place = Path(scratch) if keep is None else keep
        place.mkdir(parents=True, exist_ok=True)
        cases = [(kind, seed + k) for kind in kinds for k in range(seeds)]
        for number, (kind, own) in enumerate(track(cases, "worlds", console=console)):
            play(kind, own, shots, fps, Path(scratch) / f"sealed-{number:04d}.json", place / f"{number:04d}")
        with crew() as workers:
            opened = [
                judge(kind, own, place / f"{number:04d}", workers)
                for number, (kind, own) in enumerate(track(cases, "diagnosis", console=console))
            ]
            measured = list(_measured(real, place, workers)) if real is not None else []
    if as_json:
        print(json.dumps({"cases": [_row(one) for one in opened], "measured": measured}, allow_nan=False))
        return
    screen = standard_output()
    if opened:
        _tell(screen, opened, marks_of(opened))
    if measured:
        grid = Grid("measured", "shots", "answer", "right", "error before", "after", "floor", box=None, pad_edge=False)
        for row in measured:
            errors = (f"{row[name]:.3g}" if row[name] is not None else "-" for name in ("before", "after", "floor"))
            grid.add_row(row["set"], str(row["shots"]), row["answer"], "yes" if row["right"] else "no", *errors)
        screen.print(grid)


def _tell(screen: Console, cases: list[Any], marks: Any) -> None:
    from pipeline.experiments.gapcheck.case_scores import calibration, confusion

    grid = Grid("withheld", "said", "times", box=None, pad_edge=False)
    for kind, said, times in confusion(cases):
        grid.add_row(kind, said, str(times))
    screen.print(grid)
    rows = (
        ("one effect missing: named", marks.named),
        ("named, or in its group", marks.grouped),
        ("two effects missing: both named", marks.pairs),
        ("nothing missing: false alarms", marks.alarms),
        ("in no library: said to be unknown", marks.unknowns),
        ("shots that cannot tell: no guess", marks.traps),
        ("closed part of the gap over an oracle's: median, tenth percentile", "{:.3f}, {:.3f}".format(*marks.closed)),
        ("its interval holds the oracle's", marks.covered),
    )
    grid = Grid("asked", "found", box=None, pad_edge=False)
    for asked, found in rows:
        grid.add_row(asked, str(found))
    screen.print(grid)
    grid = Grid("probability said", "right", box=None, pad_edge=False)
    for low, high, rate in calibration(cases):
        if rate.of:
            grid.add_row(f"{low:.2f} to {high:.2f}", str(rate))
    screen.print(grid)


def _row(one: Any) -> dict[str, Any]:
    closed, oracle = (None if math.isnan(value) else value for value in (one.closed, one.oracle))
    return {
        "kind": one.kind.name, "seed": one.seed, "withheld": sorted(one.kind.withheld), "foreign": one.kind.foreign,
        "answer": one.answer, "named": list(one.named), "probability": one.probability, "closed": closed,
        "interval": None if closed is None else list(one.interval), "oracle": oracle,
    }  # fmt: skip


def _measured(real: Path, place: Path, workers: Crew) -> Iterator[dict[str, Any]]:
    """A row for each set of measurements that lies in `real`."""
    from diagnosis.diagnose import diagnose
    from pipeline.experiments.gapcheck.measured_cases import SETS, write_measured
    from pipeline.io.gap_files import write_gap
    from pipeline.io.track_folder import read_track_folders
    from pipeline.io.track_folder_scene import open_scene

    for one in SETS:
        folder = place / one.name.replace(" ", "-")
        try:
            shots = write_measured(one, real, folder)
        except FileNotFoundError as missing:
            console.print(f"{one.name}: {missing.filename} is not there; left out", markup=False)
            continue
        read = read_track_folders([folder])
        report = diagnose(open_scene(read), read.recordings, crew=workers)
        write_gap(report, folder / "gap")
        told = report.gap.closing
        said = report.effects or (report.verdict,)
        right = bool(set(report.effects) & set(one.missing)) if one.missing else not report.effects
        errors = {
            name: None if math.isnan(value) else value
            for name, value in (("before", told.before), ("after", told.after), ("floor", told.floor))
        }
        yield {"set": one.name, "shots": shots, "answer": " + ".join(said), "right": right, **errors}
