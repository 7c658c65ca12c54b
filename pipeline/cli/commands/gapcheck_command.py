"""`trueroll gapcheck`: check the diagnosis blindly."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import track

from models.core.errors import OptionError
from pipeline.engine.extras import name_remedy
from pipeline.engine.helper_executor import open_executor
from pipeline.io.strict_json import format_strict_json
from pipeline.terminal import command_line as cli

if TYPE_CHECKING:
    from pipeline.experiments.gapcheck.real_sets import OpenedSet


@cli.command("gapcheck")
def gapcheck(
    only: str = "",
    every: Annotated[bool, typer.Option("--all")] = False,
    seeds: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    shots: Annotated[int, typer.Option(min=5)] = 12,
    fps: Annotated[float, typer.Option(min=5)] = 60.0,
    real: Annotated[list[Path] | None, typer.Option(metavar="DIR")] = None,
    keep: Path | None = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Check `diagnose` blindly on simulators that withhold an effect, or on real shots with a sealed answer.

    Each simulator runs in a separate process and writes a track folder. Which effect it withheld is sealed until the
    report is written. The command prints how often the effect was named, false alarms, unknown effects, the closed part
    of the gap, and the calibration of the probabilities.

    On two idle cores it takes about six minutes: three for sliding, flying and swinging bodies (`--only slide`,
    `flight` or `pendulum` checks a part of them), and half a minute per billiards table. With `--all` it takes about
    twenty-five, three of them for the bodies between walls and those with known inputs.

    With `--real`, no case is simulated. The answer to a set is opened once its report is written. The command prints
    one row per set; a set that cannot be read is one row with the reason, and makes the exit status 1.

    Args:
        only: Check only kinds of case, or sets of --real, whose name contains this word.
        every: Check all kinds of cases, also bodies between walls and with known inputs.
        seeds: Number of cases of each kind.
        seed: Random seed of the first case of each kind.
        shots: Number of shots of a case.
        fps: Frame rate of the cases, in frames per second.
        real: Check sets of real shots instead of simulated cases: a folder with answers.json and one track folder per
            set, or with the public measurements that docs/explanation/diagnosis.md names. May be repeated.
        keep: Folder in which to keep the track folders and their reports.
    """
    if real:
        with TemporaryDirectory() as scratch:
            opened_sets = _check_real_sets(real, only, seed, keep or Path(scratch))
        if as_json:
            measured = [_set_to_json(one) for one in opened_sets]
            print(format_strict_json({"cases": [], "measured": measured}, indent=None))
        else:
            _print_sets(opened_sets)
        if any(one.unreadable for one in opened_sets):
            raise typer.Exit(1)
        return
    from pipeline.experiments.gapcheck.billiards_cases import DEFAULT_KINDS, KINDS
    from pipeline.experiments.gapcheck.blind_case import diagnose_case, score_cases, simulate_case

    selected = [kind for kind in (KINDS if only or every else DEFAULT_KINDS) if only in kind.name]
    if not selected:
        raise OptionError(f"--only {only!r} fits no kind of case; there are {'; '.join(kind.name for kind in KINDS)}")
    kinds = [kind for kind in selected if not kind.engine or find_spec(kind.engine)]
    if lacking := sorted({kind.engine for kind in selected} - {kind.engine for kind in kinds}):
        cli.print_note(
            f"{len(selected) - len(kinds)} kinds are left out: their simulators need {', '.join(lacking)}; "
            f"{name_remedy('check')}"
        )
    with TemporaryDirectory() as scratch:
        place = Path(scratch) if keep is None else keep
        place.mkdir(parents=True, exist_ok=True)
        cases = [(kind, seed + k) for kind in kinds for k in range(seeds)]
        for number, (kind, own) in enumerate(track(cases, "worlds", console=cli.console)):
            simulate_case(kind, own, shots, fps, Path(scratch) / f"sealed-{number:04d}.json", place / f"{number:04d}")
        with open_executor() as executor:
            opened = [
                diagnose_case(kind, own, place / f"{number:04d}", executor)
                for number, (kind, own) in enumerate(track(cases, "diagnosis", console=cli.console))
            ]
    if as_json:
        print(json.dumps({"cases": [_case_to_json(one) for one in opened], "measured": []}, allow_nan=False))
        return
    if opened:
        _print_scores(opened, score_cases(opened))


def _print_scores(cases: list[Any], marks: Any) -> None:
    from pipeline.experiments.gapcheck.blind_case import compute_calibration, count_confusions

    cli.print_rows(("withheld", "answer", "times"), (map(str, one) for one in count_confusions(cases)))
    scores = (
        ("one effect missing: named", marks.named),
        ("named, or in its group", marks.grouped),
        ("two effects missing: both named", marks.pairs),
        ("nothing missing: false alarms", marks.alarms),
        ("in no library: reported as unknown", marks.unknowns),
        ("undecidable shots: no guess", marks.traps),
        ("closed part of the gap over an oracle's: median, tenth percentile", "{:.3f}, {:.3f}".format(*marks.closed)),
        ("its interval holds the oracle's", marks.covered),
    )
    cli.print_rows(("question", "result"), ((question, str(score)) for question, score in scores))
    rates = ((f"{low:.2f} to {high:.2f}", str(rate)) for low, high, rate in compute_calibration(cases) if rate.of)
    cli.print_rows(("stated probability", "right"), rates)


def _case_to_json(one: Any) -> dict[str, Any]:
    """Return a scored case as JSON values."""
    closed, oracle = (None if math.isnan(value) else value for value in (one.closed, one.oracle))
    return {
        "kind": one.kind.name, "seed": one.seed, "withheld": sorted(one.kind.withheld), "foreign": one.kind.foreign,
        "answer": one.answer, "named": list(one.named), "probability": one.probability, "closed": closed,
        "interval": None if closed is None else list(one.interval), "oracle": oracle,
    }  # fmt: skip


def _check_real_sets(folders: list[Path], only: str, seed: int, place: Path) -> list[OpenedSet]:
    """Diagnose the sets of folders, with reports in `place`, and open their answers."""
    from pipeline.experiments.gapcheck.real_sets import diagnose_real_set, list_real_sets

    place.mkdir(parents=True, exist_ok=True)
    every = [one for folder in folders for one in list_real_sets(folder, place)]
    names = Counter(one.name for one in every)
    if repeated := sorted(name for name, count in names.items() if count > 1):
        raise OptionError(f"--real lists two sets of the same name: {', '.join(repeated)}")
    selected = [one for one in every if only in one.name]
    if not selected:
        raise OptionError(f"--only {only!r} fits no set; there are {', '.join(names)}")
    with open_executor() as executor:
        return [
            diagnose_real_set(one, place / one.name / "gap", seed, executor)
            for one in track(selected, "diagnosis", console=cli.console)
        ]


def _print_sets(rows: list[OpenedSet]) -> None:
    """Print one row per set, and the counts."""
    screen, cells = cli.make_output_console(), []
    read = [one for one in rows if not one.unreadable]
    for one in read:
        first = "-" if one.first_right is None else "yes" if one.first_right else "no"
        numbers = (f"{value:.3g}" if math.isfinite(value) else "-" for value in (one.after, one.floor))
        cells.append((
            one.name, (" | " if one.verdict == "group" else " + ").join(one.named),
            f"{one.probability:.2f}" if math.isfinite(one.probability) else "-", "yes" if one.right else "no", first,
            f"{one.closed:.1%}" if math.isfinite(one.closed) else "-",
            f"{one.before:.3g} {one.unit}" if math.isfinite(one.before) else "-", *numbers, f"{one.seconds:.1f}",
        ))  # fmt: skip
    cli.print_rows(("set", "answer", "probability", "right", "first right", "closed", "error before", "after", "floor",
                    "seconds"), cells)  # fmt: skip
    for one in rows:
        if one.unreadable:
            screen.print(f"{one.name}: {one.unreadable}", markup=False)
    named = [one for one in read if one.first_right is not None]
    certain = sum(one.is_falsely_certain for one in read)
    screen.print(
        f"right: {sum(one.right for one in read)} of {len(read)}; first named effect right:"
        f" {sum(bool(one.first_right) for one in named)} of {len(named)}; unknown at 1.00 although an effect closes"
        f" 90 %: {certain}",
        highlight=False,
    )


def _set_to_json(one: OpenedSet) -> dict[str, Any]:
    """Return an opened set as JSON values."""
    if one.unreadable:
        return {"set": one.name, "unreadable": one.unreadable}
    facts = asdict(one)
    del facts["name"], facts["unreadable"]
    shares = {name: share for name, share in one.shares.items() if math.isfinite(share)}
    return {"set": one.name, "answer": " + ".join(one.named), **facts, "shares": shares}
