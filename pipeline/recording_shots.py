"""Finds the shots of a recording, and runs the one that was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from models.core.errors import ClipError, OptionError, TableNotFound, TruerollError
from pipeline.chain import (
    FinishedRally,
    FinishedRun,
    build_court_graph,
    hash_clip,
    honour_corrections,
    make_change_check,
    run_clip,
)
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import RunWatcher, StageGraph
from pipeline.run_options import RunOptions
from pipeline.stages.read_stage import open_frame_memory, read_stage
from pipeline.stages.shot_stages import ClipShot, find_single_span, shots_stage
from video.io.clip import Clip
from video.io.frame_memory import FrameMemory


@dataclass(frozen=True, slots=True)
class ShotChoice:
    """The shot of a recording that a user asked for; both None for the longest one."""

    number: int | None = None
    """Number of the shot, from 1."""
    at: float | None = None
    """s, a time within the shot."""


LONGEST_SHOT = ShotChoice()
# s of a view of a court that may show a rally: a serve and its landing take as long.
MIN_RALLY_S = 1.0
# Views, the longest, of a recording without a table in which a court is searched: others show players and spectators.
COURT_TRIES = 3


@dataclass(frozen=True, slots=True)
class RecordingShots:
    """The shots of a recording; none where the clip is one shot as a whole."""

    shots: tuple[ClipShot, ...] = ()
    replays: int = 0
    """Number of replays, which are left out."""
    views_without_table: int = 0


def find_recording_shots(
    clip: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    snapshot: SourceSnapshot | None = None,
    memory: FrameMemory | None = None,
) -> RecordingShots:
    """Find the shots of a recording, whose frames `memory` keeps.

    A clip without a cut or a fade that is too short for several shots is not searched. Of a court, every view is one: a
    cut ends a rally.

    Args:
        clip: Path of the recording.
        options: Options of all stages.
        watcher: Follows the search.
        snapshot: The project's code when this process started; see `StageGraph.run`.
        memory: Keeps the decoded frames for the stages; None decodes the recording in each.

    Returns:
        The shots; without one in a recording of several views, the longest view.

    Raises:
        TruerollError: The recording or an option cannot be used.
    """
    unchanged = make_change_check(clip)
    read, whole = _read_recording(clip, options, cache, watcher, unchanged, snapshot, memory)
    from video.calibration.shot_segmentation import list_shot_spans  # slow to import

    court = honour_corrections(clip, whole.digest, options).court
    if court.has_court:
        return RecordingShots(_list_views(whole, unchanged))
    if find_single_span(whole):
        return RecordingShots()
    graph = StageGraph.from_stages([read, shots_stage()], whole.digest)
    intervals = graph.load("shots", graph.run(cache, watcher, partial(unchanged, whole.digest), snapshot))
    spans = list_shot_spans(whole, intervals)
    if not len(intervals) and court.sport is None:
        views = _list_views(whole, unchanged)
        longest = sorted(views, key=lambda view: view.begins - view.ends)[:COURT_TRIES]
        if any(_shows_court(clip, options, view, cache, watcher, memory) for view in longest):
            return RecordingShots(views)
    if not spans:
        return RecordingShots()
    shots = tuple(
        ClipShot(whole, number, first, stop, unchanged, motion_s)
        for number, (first, stop, motion_s) in enumerate(spans)
    )
    return RecordingShots(shots, len(intervals.replays), intervals.views_without_table)


def _list_views(whole: Clip, unchanged: Callable[[str], None]) -> tuple[ClipShot, ...]:
    """List the views of a recording that may show a rally; none where it is one view."""
    spans = [(first, stop, float(whole.t[stop - 1] - whole.t[first])) for first, stop in whole.views.tolist()]
    lasting = [span for span in spans if span[2] >= MIN_RALLY_S] if len(spans) > 1 else []
    return tuple(
        ClipShot(whole, number, first, stop, unchanged, seconds)
        for number, (first, stop, seconds) in enumerate(lasting)
    )


def _shows_court(
    clip: Path, options: RunOptions, view: ClipShot, cache: ResultCache, watcher: RunWatcher, memory: FrameMemory | None
) -> bool:
    """Find out whether a view shows a court."""
    part = None if memory is None else memory.extract_frames(view.first, view.stop)
    try:
        build_court_graph(clip, options, view, part).select("court").run(cache, watcher)
    except ClipError:
        return False
    return True


def read_recording_shot(
    clip: Path, options: RunOptions, span: tuple[int, int], number: int, cache: ResultCache, watcher: RunWatcher
) -> ClipShot:
    """Read a recording, with the frame rate of its corrections, and cut one shot out of it.

    Args:
        clip: Path of the recording.
        options: Options of all stages.
        span: First frame of the shot, and the frame after its last.
        number: Number of the shot, from 0.
        watcher: Follows the run.

    Returns:
        The shot.

    Raises:
        TruerollError: The recording or an option cannot be used.
    """
    unchanged = make_change_check(clip)
    return ClipShot(_read_recording(clip, options, cache, watcher, unchanged)[1], number, *span, unchanged)


def read_whole_clip(clip: Path, options: RunOptions, cache: ResultCache, watcher: RunWatcher) -> Clip:
    """Read a clip, with the frame rate of its corrections; raises TruerollError."""
    return _read_recording(clip, options, cache, watcher, make_change_check(clip))[1]


def _read_recording(
    clip: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    unchanged: Callable[[str], None],
    snapshot: SourceSnapshot | None = None,
    memory: FrameMemory | None = None,
) -> tuple[Stage, Clip]:
    """Read a recording with the frame rate of its corrections; also return the stage that reads it."""
    digest = hash_clip(clip)
    read = read_stage(clip, digest, honour_corrections(clip, digest, options).read, memory)
    graph = StageGraph.from_stages([read], digest)
    return read, graph.load("read", graph.run(cache, watcher, partial(unchanged, digest), snapshot))


def order_shots(recording: RecordingShots, choice: ShotChoice) -> list[ClipShot]:
    """Order the shots by preference, each with a sentence about the seconds that it uses.

    Args:
        recording: The shots of a recording, at least one.
        choice: The shot that the user asked for.

    Returns:
        The shot that was asked for; else all, the longest first, and of equals the earlier. A span in which nothing as
        small as a ball moves comes last.

    Raises:
        OptionError: There is no such shot.
    """
    from video.calibration.shot_segmentation import rank_span  # slow to import

    shots = recording.shots
    if choice.number is not None:
        if not 1 <= choice.number <= len(shots):
            raise OptionError(f"--shot is a number from 1 to {len(shots)}; got {choice.number}")
        chosen = [shots[choice.number - 1]]
    elif choice.at is not None:
        chosen = [shot for shot in shots if shot.begins <= choice.at <= shot.ends]
        if not chosen:
            spans = ", ".join(f"{shot.begins:.2f} to {shot.ends:.2f}" for shot in shots)
            raise OptionError(f"--at is a time in one of the shots, {spans} s; got {choice.at:g}")
    else:
        chosen = sorted(shots, key=lambda shot: rank_span(shot.begins, shot.ends, shot.motion_s))
    duration, is_default = float(shots[0].whole.t[-1]), choice == LONGEST_SHOT
    return [replace(shot, note=_format_used_span(shot, len(shots), duration, is_default)) for shot in chosen]


def _format_used_span(shot: ClipShot, count: int, duration: float, is_default: bool) -> str:
    """Format which seconds of a recording (duration, s) of several shots are used, and why, without a full stop."""
    if count == 1:
        why = "the only shot" if shot.has_motion else "the longest view, in which nothing moves"
    else:
        why = f"the longest of {count} shots" if is_default else f"shot {shot.number + 1} of {count}"
    frames = f"frames {shot.first} to {shot.stop - 1}"
    return f"seconds {shot.begins:.2f} to {shot.ends:.2f} of {duration:.2f} s are used, {frames}: {why}"


def run_chosen_shot(
    clip: Path,
    folder: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    choice: ShotChoice = LONGEST_SHOT,
    **how: Any,
) -> FinishedRun | FinishedRally:
    """Run a clip, or of a recording with several views or shots the one that was asked for.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        options: Options of all stages.
        watcher: Follows the run.
        choice: The shot to run.
        how: Further arguments of `run_clip`.

    Returns:
        The run; its notes list the other shots.

    Raises:
        TruerollError: The clip or an option cannot be used.
    """
    memory = open_frame_memory()
    recording = find_recording_shots(clip, options, cache, watcher, memory=memory)
    if not recording.shots:
        if choice.number not in (None, 1):
            raise OptionError(f"{clip.name} is one shot; leave out --shot {choice.number}")
        return run_clip(clip, folder, options, cache, watcher, memory=memory, **how)
    refusals: list[TruerollError] = []
    has_court = honour_corrections(clip, recording.shots[0].whole.digest, options).court.has_court
    refused: type[TruerollError] = ClipError if has_court else TableNotFound
    for shot in order_shots(recording, choice):
        others = tuple(
            f"shot {other.number + 1}, seconds {other.begins:.2f} to {other.ends:.2f}: --shot {other.number + 1}"
            f" or --at {(other.begins + other.ends) / 2:.1f}"
            for other in recording.shots
            if other.number != shot.number
        )
        try:
            part = memory.extract_frames(shot.first, shot.stop)
            return run_clip(clip, folder, options, cache, watcher, memory=part, shot=shot, notes=others, **how)
        except refused as error:
            refusals.append(error)
    raise refusals[0]
