"""`trueroll gapcheck`: check the diagnosis blindly."""

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
from models.numerics.executor import Executor
from pipeline.engine.helper_executor import open_executor
from pipeline.terminal.command_line import DebugOption, JsonOption, app, console, make_output_console


@app.command("gapcheck")
def gapcheck(
    only: Annotated[str, typer.Option("--only", help="Check only kinds of case whose name contains this word.")] = "",
    every: Annotated[
        bool, typer.Option("--all", help="Check all kinds of billiards cases instead of one per question.")
    ] = False,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of cases of each kind.")] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the first case of each kind.")] = 0,
    shots: Annotated[int, typer.Option("--shots", min=5, help="Number of shots of a case.")] = 12,
    fps: Annotated[float, typer.Option("--fps", min=5, help="Frame rate of the cases, in frames per second.")] = 60.0,
    real: Annotated[
        Path | None,
        typer.Option(
            "--real",
            metavar="DIR",
            help="Folder of real measurements (track folders) to check in addition to the simulated cases.",
        ),
    ] = None,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Folder in which to keep the track folders and their reports.")
    ] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Check `diagnose` blindly on simulators that withhold an effect, and on measurements with a known effect.

    Each simulator runs in a separate process and writes a track folder. Which effect it withheld is sealed until the
    report is written. The command prints how often the effect was named, false alarms, unknown effects, the closed part
    of the gap, and the calibration of the probabilities.

    On two idle cores it takes about six minutes, with `--all` about twenty, half a minute per table. Sliding, flying
    and swinging bodies take three minutes together (`--only slide`, `flight` or `pendulum`).
    """
    from pipeline.experiments.gapcheck.blind_case import diagnose_case, simulate_case
    from pipeline.experiments.gapcheck.case_catalogue import DEFAULT_KINDS, KINDS
    from pipeline.experiments.gapcheck.case_scores import score_cases

    selected = [kind for kind in (KINDS if only or every else DEFAULT_KINDS) if only in kind.name]
    if not selected and real is None:
        raise OptionError(f"--only {only!r} fits no kind of case; there are {'; '.join(kind.name for kind in KINDS)}")
    kinds = [kind for kind in selected if not kind.engine or find_spec(kind.engine)]
    if lacking := sorted({kind.engine for kind in selected} - {kind.engine for kind in kinds}):
        console.print(
            f"{len(selected) - len(kinds)} kinds are left out: their simulators need {', '.join(lacking)}; install"
            " trueroll with the extra check: .[check]",
            markup=False,
        )
    with TemporaryDirectory() as scratch:
        place = Path(scratch) if keep is None else keep
        place.mkdir(parents=True, exist_ok=True)
        cases = [(kind, seed + k) for kind in kinds for k in range(seeds)]
        for number, (kind, own) in enumerate(track(cases, "worlds", console=console)):
            simulate_case(kind, own, shots, fps, Path(scratch) / f"sealed-{number:04d}.json", place / f"{number:04d}")
        with open_executor() as executor:
            opened = [
                diagnose_case(kind, own, place / f"{number:04d}", executor)
                for number, (kind, own) in enumerate(track(cases, "diagnosis", console=console))
            ]
            measured = list(_diagnose_measurements(real, place, executor)) if real is not None else []
    if as_json:
        print(json.dumps({"cases": [_case_to_json(one) for one in opened], "measured": measured}, allow_nan=False))
        return
    screen = make_output_console()
    if opened:
        _print_scores(screen, opened, score_cases(opened))
    if measured:
        grid = Grid("measured", "shots", "answer", "right", "error before", "after", "floor", box=None, pad_edge=False)
        for row in measured:
            errors = (f"{row[name]:.3g}" if row[name] is not None else "-" for name in ("before", "after", "floor"))
            grid.add_row(row["set"], str(row["shots"]), row["answer"], "yes" if row["right"] else "no", *errors)
        screen.print(grid)


def _print_scores(screen: Console, cases: list[Any], marks: Any) -> None:
    from pipeline.experiments.gapcheck.case_scores import compute_calibration, count_confusions

    grid = Grid("withheld", "answer", "times", box=None, pad_edge=False)
    for kind, answer, times in count_confusions(cases):
        grid.add_row(kind, answer, str(times))
    screen.print(grid)
    rows = (
        ("one effect missing: named", marks.named),
        ("named, or in its group", marks.grouped),
        ("two effects missing: both named", marks.pairs),
        ("nothing missing: false alarms", marks.alarms),
        ("in no library: reported as unknown", marks.unknowns),
        ("undecidable shots: no guess", marks.traps),
        ("closed part of the gap over an oracle's: median, tenth percentile", "{:.3f}, {:.3f}".format(*marks.closed)),
        ("its interval holds the oracle's", marks.covered),
    )
    grid = Grid("question", "result", box=None, pad_edge=False)
    for question, score in rows:
        grid.add_row(question, str(score))
    screen.print(grid)
    grid = Grid("stated probability", "right", box=None, pad_edge=False)
    for low, high, rate in compute_calibration(cases):
        if rate.of:
            grid.add_row(f"{low:.2f} to {high:.2f}", str(rate))
    screen.print(grid)


def _case_to_json(one: Any) -> dict[str, Any]:
    """Return a scored case as JSON values."""
    closed, oracle = (None if math.isnan(value) else value for value in (one.closed, one.oracle))
    return {
        "kind": one.kind.name, "seed": one.seed, "withheld": sorted(one.kind.withheld), "foreign": one.kind.foreign,
        "answer": one.answer, "named": list(one.named), "probability": one.probability, "closed": closed,
        "interval": None if closed is None else list(one.interval), "oracle": oracle,
    }  # fmt: skip


def _diagnose_measurements(real: Path, place: Path, executor: Executor) -> Iterator[dict[str, Any]]:
    """Diagnose each set of measurements in a folder and yield one row per set."""
    from diagnosis.diagnose import diagnose
    from pipeline.experiments.gapcheck.measured_cases import MEASURED_SETS, write_measured_set
    from pipeline.io.gap_files import write_gap_files
    from pipeline.io.track_folder import read_track_folders
    from pipeline.io.track_folder_scene import build_gap_scene

    for one in MEASURED_SETS:
        folder = place / one.name.replace(" ", "-")
        try:
            shots = write_measured_set(one, real, folder)
        except FileNotFoundError as missing:
            console.print(f"{one.name}: {missing.filename} is not there; left out", markup=False)
            continue
        read = read_track_folders([folder])
        report = diagnose(build_gap_scene(read), read.recordings, executor=executor)
        write_gap_files(report, folder / "gap")
        closing = report.gap.closure
        answer = report.effects or (report.verdict,)
        right = bool(set(report.effects) & set(one.missing)) if one.missing else not report.effects
        errors = {
            name: None if math.isnan(value) else value
            for name, value in (("before", closing.before), ("after", closing.after), ("floor", closing.floor))
        }
        yield {"set": one.name, "shots": shots, "answer": " + ".join(answer), "right": right, **errors}
