"""`trueroll run`: run one clip and write the folder of its results."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.stroke_summary import summarize_strokes
from models.numerics.jit import notify_first_compilation
from pipeline.chain import FinishedRally, FinishedRun, default_run_folder
from pipeline.engine.helper_executor import DeferredExecutor
from pipeline.engine.result_cache import open_cache
from pipeline.io.rally_files import build_rally_clock, tabulate_strokes
from pipeline.io.run_tables import describe_shot_numbers
from pipeline.io.strict_json import replace_nonfinite
from pipeline.recording_shots import ShotChoice, run_chosen_shot
from pipeline.reporting.text.check_sentences import format_event_probability
from pipeline.reporting.text.fit_sentences import format_whole_shot
from pipeline.reporting.text.number_sentences import format_shot_line
from pipeline.reporting.text.rally_sentences import describe_landing_call, format_landing, list_event_rows
from pipeline.reporting.text.stroke_sentences import NARROW_COLUMNS, STROKE_HEADINGS, format_point, list_stroke_rows
from pipeline.reporting.text.text_formatting import (
    format_event,
    format_event_time,
    format_no_events,
    format_trust_line,
    summarize_trust,
)
from pipeline.run_options import RunOptions, build_options, list_settings, use_growing_profile
from pipeline.stages.detect_stage import load_detectors
from pipeline.stages.kernel_preparation import KernelPreparation
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings
from pipeline.terminal.progress_display import COMPILING_NOTE, StageDisplay


@cli.command("run")
@add_settings(list_settings(), build_options)
def run(
    clip: Path,
    options: RunOptions,
    out: Annotated[Path | None, cli.OUT] = None,
    update_profile: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    shot: Annotated[int | None, typer.Option(min=1)] = None,
    at: Annotated[float | None, typer.Option(min=0.0)] = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Turn a clip into annotated slow motion, tracks, contacts and a fitted model.

    Args:
        clip: A clip of a shot or of a rally: mp4, mov, mkv, avi, webm.
        out: Folder of the results. Default: out/<clip>.
        update_profile: Table profile that this run starts from, as with --profile, and improves; a missing file is
            started.
        shot: Number of the shot in a recording. Default: the longest.
        at: A time in the shot, in s of the recording, instead of --shot.
    """
    folder = out if out is not None else default_run_folder(clip)
    store = open_cache(cache)
    if update_profile is not None:
        options = use_growing_profile(options, update_profile)
    answers: list[FinishedRun | FinishedRally] = []
    with (
        DeferredExecutor(load_detectors) as executor,
        KernelPreparation() as kernels,
        StageDisplay(cli.console, str(clip)) as display,
        notify_first_compilation(lambda: cli.print_note(COMPILING_NOTE)),
    ):

        def start_helpers(done: Collection[str]) -> None:
            """Start a second process if coming stages need one: to compile code, or else to share the detection."""
            is_compiling = kernels.start(done)  # on the second core
            if "detect" not in done and not is_compiling:
                executor.start()

        def print_answer(answer: FinishedRun | FinishedRally) -> None:
            """Print the answer while the rest is still made."""
            answers.append(answer)
            with display.pause():
                _print_answer(answer)

        finished = run_chosen_shot(
            clip, folder, options, store, display, ShotChoice(shot, at), executor=executor,
            answer_listener=None if as_json else print_answer, start_helpers=start_helpers,
        )  # fmt: skip
    if as_json:
        _print_notes(finished.notes)
    elif not answers:
        _print_answer(finished)
    if update_profile is not None and isinstance(finished, FinishedRun):
        from pipeline.io import view_profile  # pydantic is slow to import

        begun = view_profile.update_profile(update_profile, finished.folder)
        _print_notes((*begun, f"{update_profile} now holds this run too"))
    if as_json:
        print(json.dumps(_run_to_json(finished), allow_nan=False))
    elif not options.render.no_video:
        print(f"Slow motion: {finished.folder / 'slow.mp4'}")


def _print_notes(notes: Iterable[str]) -> None:
    """Print notes."""
    for note in notes:
        cli.print_note(f"Note: {note}")


def _rally_to_json(finished: FinishedRally) -> dict[str, Any]:
    """Return folder, sport, trust level, events, strokes and the call of the landing as JSON values.

    Times are those of the clip, as in the tables.
    """
    rally, clock = finished.rally, build_rally_clock(finished.clip, finished.rally)
    names = ("kind", "t", "t_sigma", "player", "probability", "speed", "speed_sigma")
    shown = clock.presentation_time_at(np.array([one.t for one in rally.events]))
    rows = [{name: getattr(one, name) for name in names} | {"t": float(t), "place": one.place}
            for one, t in zip(rally.events, shown, strict=True)]  # fmt: skip
    landing = describe_landing_call(judge_landing(rally), rally)
    if landing["t"] is not None:
        landing["t"] = float(clock.presentation_time_at(np.array(landing["t"])))
    table = tabulate_strokes(rally, clock)
    strokes = [dict(zip(table, row, strict=True)) for row in zip(*map(list, table.values()), strict=True)]
    document = {"folder": str(finished.folder), "sport": rally.scene.sport.name,
                "trust": summarize_trust(finished.trust), "events": rows,
                "strokes": strokes, "landing": landing}  # fmt: skip
    return dict(replace_nonfinite(document))


def _run_to_json(finished: FinishedRun | FinishedRally) -> dict[str, Any]:
    """Return folder, trust level, contact models, events and numbers of the shots as JSON values."""
    if isinstance(finished, FinishedRally):
        return _rally_to_json(finished)
    fit, events = finished.fit, finished.fit.events
    names = ("kind", "t", "t_sigma", "a", "b", "probability")
    rows = [{name: getattr(events, name)[k] for name in names} for k in range(len(events))]
    return {"folder": str(finished.folder), "trust": summarize_trust(fit.trust),
            "whole_shot": "" if fit.laws is None else format_whole_shot(fit),
            "events": rows, "shot_numbers": describe_shot_numbers(fit.shot_numbers)}  # fmt: skip


def _print_rally(finished: FinishedRally) -> None:
    """Print the events, the strokes and the call of the landing."""
    rally = finished.rally
    cli.print_rows(("time", "what", "probability"), list_event_rows(rally))
    cells = [row for _, row in list_stroke_rows(rally, summarize_strokes(rally))]
    if cells:
        cli.print_rows(STROKE_HEADINGS, cells, NARROW_COLUMNS)
    call = judge_landing(rally)
    words = format_landing(call, rally)
    screen = cli.make_output_console()
    screen.print(format_point(rally, call).headline, markup=False)
    screen.print(f"{words.question} {words.sentence}", markup=False)
    if words.advice:
        screen.print(words.advice, markup=False)
    screen.print(format_trust_line(finished.trust))
    print(f"Look at {finished.folder / 'poster.png'} and {finished.folder / 'report.html'}", flush=True)


def _print_answer(finished: FinishedRun | FinishedRally) -> None:
    """Print the notes, the events and the trust level."""
    _print_notes(finished.notes)
    if isinstance(finished, FinishedRally):
        _print_rally(finished)
        return
    screen, fit = cli.make_output_console(), finished.fit
    if len(fit.events):
        rows = (
            (format_event_time(fit.events, k), format_event(fit.events, k, fit.naming),
             format_event_probability(fit.events, k, fit.explanation, fit.naming))
            for k in range(len(fit.events))
        )  # fmt: skip
        cli.print_rows(("time", "what", "probability"), rows)
    else:
        screen.print(format_no_events(fit))
    for shot in fit.shot_numbers:
        screen.print(f"Shot: {format_shot_line(shot, fit.naming, fit.events)}", markup=False)
    screen.print(format_trust_line(fit.trust))
    if fit.laws is not None:
        screen.print(format_whole_shot(fit), markup=False)
    print(f"Look at {finished.folder / 'poster.png'} and {finished.folder / 'report.html'}", flush=True)
