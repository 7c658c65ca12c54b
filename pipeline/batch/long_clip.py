"""Runs each shot of a long recording like a clip, and merges their tables."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.chain import FinishedRun, hash_clip, honour_corrections, make_change_check, run_clip, write_source
from pipeline.engine.atomic_write import replace_file, require_writable_folder, write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import RunWatcher, StageGraph, load_stage_output
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import RunOptions
from pipeline.stages.read_stage import read_stage
from pipeline.stages.shot_stages import ClipShot, shots_stage
from video.calibration.shot_segmentation import LONG_RECORDING_S, ShotIntervals
from video.io.clip import Clip
from video.io.frame_memory import FrameMemory

TIME_COLUMNS = {"tracks.csv": ("frame", "t"), "events.csv": ("frame", "t"), "trajectory.csv": ("t",)}
"""Tables that are merged, with their columns that count from the start of a shot."""
DECIMALS = 6

ShotListener = Callable[[int, int], None]
"""Called with the number of the shot that begins, from 1, and the number of shots."""


@dataclass(frozen=True, slots=True)
class ShotOutcome:
    """A shot and its run."""

    shot: ClipShot
    run: FinishedRun | None
    sentence: str
    """Why the shot failed; empty if it did not."""


def find_recording_shots(
    clip: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    snapshot: SourceSnapshot,
    memory: FrameMemory | None = None,
) -> list[ClipShot]:
    """Find the shots of a recording, whose frames `memory` keeps; empty if it is too short, or is a single shot."""
    unchanged = make_change_check(clip)
    read, whole = _read_recording(clip, options, cache, watcher, unchanged, snapshot, memory)
    if whole.t[-1] < LONG_RECORDING_S:
        return []
    graph = StageGraph.from_stages([read, shots_stage()], whole.digest)
    check = partial(unchanged, whole.digest)
    intervals: ShotIntervals = _run_stage(graph, "shots", cache, watcher, check, snapshot)
    if len(intervals) < 2 and not len(intervals.cut_frames):
        return []
    spans = zip(intervals.first_frames.tolist(), intervals.stop_frames.tolist(), strict=True)
    return [ClipShot(whole, number, *span, unchanged) for number, span in enumerate(spans)]


def read_recording_shot(
    clip: Path, options: RunOptions, span: tuple[int, int], number: int, cache: ResultCache, watcher: RunWatcher
) -> ClipShot:
    """Read a recording, with the frame rate of its corrections, and cut one shot out of it.

    Args:
        clip: Path of the recording.
        options: Options of all stages.
        span: First frame of the shot, and the frame after its last.
        number: Number of the shot, from 0.
        cache: The cache.
        watcher: Follows the run.

    Returns:
        The shot.

    Raises:
        TruerollError: The recording or an option cannot be used.
    """
    unchanged = make_change_check(clip)
    return ClipShot(_read_recording(clip, options, cache, watcher, unchanged)[1], number, *span, unchanged)


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
    return read, _run_stage(graph, "read", cache, watcher, partial(unchanged, digest), snapshot)


def _run_stage(
    graph: StageGraph,
    name: str,
    cache: ResultCache,
    watcher: RunWatcher,
    check: Callable[[], None],
    snapshot: SourceSnapshot | None,
) -> Any:
    """Run a graph and load the output of one stage."""
    entry = graph.run(cache, watcher, check, snapshot)[name]
    return load_stage_output(next(stage for stage in graph.stages if stage.name == name), entry)


def run_shots(
    clip: Path,
    shots: Sequence[ClipShot],
    folder: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    snapshot: SourceSnapshot,
    listener: ShotListener,
) -> list[ShotOutcome]:
    """Run every shot into a folder of its own, then merge their tables in `folder`.

    A shot that fails does not stop the others.

    Args:
        clip: The recording.
        shots: Its shots.
        folder: Folder of the results.
        options: Options of all stages.
        cache: The cache.
        watcher: Follows each run.
        snapshot: The project's code when this process started.
        listener: Called when a shot begins.

    Returns:
        The outcome of every shot.
    """
    require_writable_folder(folder)
    ran = []
    for shot in shots:
        listener(shot.number + 1, len(shots))
        try:
            run = run_clip(clip, folder / shot.name, options, cache, watcher, snapshot=snapshot, shot=shot)
            ran.append(ShotOutcome(shot, run, ""))
        except Exception as error:  # no error of one shot may stop the others
            ran.append(ShotOutcome(shot, None, format_error(error)))
    good = [one for one in ran if one.run is not None]
    if good:
        _merge_tables(clip, good, folder, options)
    return ran


def _merge_tables(clip: Path, ran: Sequence[ShotOutcome], folder: Path, options: RunOptions) -> None:
    """Write the merged tables, with frames and times of the recording, and a scene.json that lists the shots."""
    for name, offset in TIME_COLUMNS.items():
        with replace_file(folder / name) as path, path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            for k, line in enumerate(_read_shifted_lines(ran, folder, name, offset)):
                if k == 0 or line[0] != "shot":
                    writer.writerow(line)
    scene = json.loads((folder / ran[0].shot.name / "scene.json").read_text(encoding="utf-8"))
    scene["shots"] = [
        {
            "shot": one.shot.number, "folder": one.shot.name, "first": one.shot.first, "stop": one.shot.stop,
            "begins": one.shot.clip.start_time, "trust": one.run.fit.trust.level if one.run else "",
        }
        for one in ran
    ]  # fmt: skip
    write_text(folder / "scene.json", json.dumps(scene, indent=1, allow_nan=False))
    write_source(clip, folder, options)


def _read_shifted_lines(
    ran: Sequence[ShotOutcome], folder: Path, name: str, offset: tuple[str, ...]
) -> Iterator[list[str]]:
    """Yield the lines of one table of all shots, headers included, with shifted frames and times."""
    for one in ran:
        shift = {"frame": one.shot.first, "t": one.shot.clip.start_time}
        with (folder / one.shot.name / name).open(encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            head = next(lines)
            yield head
            columns = {head.index(column): shift[column] for column in offset}
            at = head.index("shot")
            for line in lines:
                for column, begin in columns.items():
                    line[column] = _shift_cell(line[column], begin)
                line[at] = str(one.shot.number)
                yield line


def _shift_cell(text: str, begin: float) -> str:
    """Shift a number of a table by the start of its shot; an empty cell stays empty."""
    if not text:
        return text
    if isinstance(begin, int) and text.isdecimal():
        return str(int(text) + begin)
    return f"{float(text) + begin:.{DECIMALS}f}".rstrip("0").rstrip(".")
