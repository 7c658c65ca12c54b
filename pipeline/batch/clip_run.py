"""Runs one clip of a batch from its job to its result; every error becomes a sentence."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from models.core.errors import TruerollError
from models.numerics.jit import measure_compilation
from pipeline.batch.clip_discovery import FilmLength, describe_room, estimate_bytes
from pipeline.batch.clip_job import ClipJob, ClipResult, build_failed_result, format_duration
from pipeline.batch.first_results import FirstResults
from pipeline.chain import FinishedRally, FinishedRun, run_clip, write_source
from pipeline.engine.atomic_write import remove_leftovers, replace_file, require_writable_folder, write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage_graph import RunWatcher
from pipeline.recording_shots import find_recording_shots
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import RunOptions
from pipeline.stages.detect_stage import load_detectors
from pipeline.stages.kernel_preparation import KernelPreparation
from pipeline.stages.read_stage import open_frame_memory
from pipeline.stages.shot_stages import ClipShot

# The project's code that this process runs; a later edit counts for the next process.
SNAPSHOT = SourceSnapshot()
# Compiles the kernels of the first clip before it is there, if that is asked for.
KERNELS = KernelPreparation()
TRUST_LEVELS = ("green", "amber", "red")
# Events that are contacts of balls: with each other, a cushion, a racket, the ground or the net.
CONTACTS = ("ball", "cushion", "hit", "bounce", "net", "landing")


class ShotWatcher(RunWatcher, Protocol):
    """A watcher that also follows the shots of a long recording."""

    def start_shot(self, number: int, count: int, done: float) -> None:
        """Note that shot `number` of `count` begins, and which share of all of them is done."""
        ...

    def write_note(self, sentence: str) -> None:
        """Pass on a sentence for the user."""
        ...

    def write_results(self, sentences: Sequence[str], size: tuple[int, int]) -> None:
        """Pass on first results, which are longer each time; the image of them may be new. `size` is of a frame, px."""
        ...


class CacheUseWatcher:
    """A watcher that forwards to another one and notes whether all stages were cached."""

    def __init__(self, watcher: RunWatcher) -> None:
        self._watcher = watcher
        self.start_stage = watcher.start_stage
        self.cached = True

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Note whether the stage was cached, and forward."""
        self.cached &= cached
        self._watcher.finish_stage(stage, seconds, cached)


def run_job(job: ClipJob, watcher: ShotWatcher) -> ClipResult:
    """Run a clip. Errors of the clip, the disk or the cache become a failed result.

    Args:
        job: The clip.
        watcher: Follows the run.

    Returns:
        Its result.
    """
    with measure_compilation() as measure:
        try:
            result = _run_clip_or_shots(job, watcher)
        except Exception as error:  # no error of one clip may stop the batch
            remedy = error.remedy if isinstance(error, TruerollError) else ""
            result = build_failed_result(job.name, format_error(error, for_page=job.for_page), remedy=remedy)
        return replace(result, compiling=round(measure(), 3))


def prepare_run() -> None:
    """Load what any run needs: modules, networks and compiled code; without the last, start to compile it."""
    load_detectors()
    KERNELS.prepare()


def _run_clip_or_shots(job: ClipJob, watcher: ShotWatcher) -> ClipResult:
    """Run a clip as a whole, or each of its shots if it is a long recording."""
    cache, counted = ResultCache(Path(job.cache), mark=job.mark), CacheUseWatcher(watcher)
    clip, folder, options = Path(job.clip), Path(job.folder), job.options
    remove_leftovers(folder)
    first = FirstResults(Path(job.preview), watcher.write_results) if job.preview else None
    listener = None if first is None else first.follow
    with open_frame_memory() as memory:
        shots = find_recording_shots(clip, options, cache, counted, SNAPSHOT, memory).shots
        if not shots:
            with KernelPreparation() as kernels:
                run = run_clip(
                    clip, folder, options, cache, counted, snapshot=SNAPSHOT, start_helpers=kernels.start,
                    memory=memory, result_listener=listener,
                )  # fmt: skip
            if first is not None:
                first.conclude(run)
            return _summarize_runs(job, [run], "", counted.cached)
    watcher.write_note(f"{job.name}: {_plan_shots(shots, folder, cache, options)}")
    ran = _run_shots(job, shots, cache, counted, watcher)
    good = [one.run for one in ran if one.run is not None]
    bad = [one for one in ran if one.run is None]
    if not good:
        return build_failed_result(job.name, f"none of {len(ran)} shots could be used; the first: {bad[0].sentence}")
    sentence = f"{len(bad)} of {len(ran)} shots could not be used; {bad[0].shot.name}: {bad[0].sentence}" if bad else ""
    return _summarize_runs(job, good, sentence, counted.cached, in_shots=True)


def _plan_shots(shots: Sequence[ClipShot], folder: Path, cache: ResultCache, options: RunOptions) -> str:
    """Say what the shots of a recording will take; raise OptionError if the disks do not hold it."""
    whole, frames = shots[0].whole, sum(shot.frame_count for shot in shots)
    films = [FilmLength(folder / shot.name, whole.width * whole.height, shot.frame_count) for shot in shots]
    room = describe_room(estimate_bytes(films, options.render), folder, cache.root)
    seconds = frames * float(whole.t[-1]) / whole.frame_count
    return f"{len(shots)} shot{'s' * (len(shots) != 1)}, {format_duration(seconds)} in all; {room}"


def _summarize_runs(
    job: ClipJob, runs: list[FinishedRun | FinishedRally], sentence: str, cached: bool, *, in_shots: bool = False
) -> ClipResult:
    """Summarize the runs of a clip."""
    light = max((run.trust.level for run in runs), key=TRUST_LEVELS.index)
    contacts = sum(kind in CONTACTS for run in runs for kind, _ in _list_events(run))
    last = max((t for run in runs for _, t in _list_events(run)), default=0.0)
    return ClipResult(
        job.name, "done", light, contacts, round(last, 3), job.folder, sentence, shots=len(runs), cached=cached,
        in_shots=in_shots,
    )  # fmt: skip


def _list_events(run: FinishedRun | FinishedRally) -> list[tuple[str, float]]:
    """List kind and time, s, of the events of a run."""
    if isinstance(run, FinishedRally):
        return [(one.kind, one.t) for one in run.rally.events]
    return list(zip(run.fit.events.kind, run.fit.events.t.tolist(), strict=True))


MERGED_TABLES = ("tracks.csv", "events.csv", "trajectory.csv")


@dataclass(frozen=True, slots=True)
class ShotOutcome:
    """A shot and its run."""

    shot: ClipShot
    run: FinishedRun | FinishedRally | None
    sentence: str
    """Why the shot failed; empty if it did not."""


def _run_shots(
    job: ClipJob, shots: Sequence[ClipShot], cache: ResultCache, counted: RunWatcher, watcher: ShotWatcher
) -> list[ShotOutcome]:
    """Run every shot into a folder of its own, then merge their tables; one that fails does not stop the others."""
    clip, folder, options = Path(job.clip), Path(job.folder), job.options
    require_writable_folder(folder)
    ran, done, frames = [], 0, sum(shot.frame_count for shot in shots)
    for shot in shots:
        watcher.start_shot(shot.number + 1, len(shots), done / frames)
        done += shot.frame_count
        try:
            run = run_clip(clip, folder / shot.name, options, cache, counted, snapshot=SNAPSHOT, shot=shot)
            ran.append(ShotOutcome(shot, run, ""))
        except Exception as error:  # no error of one shot may stop the others
            ran.append(ShotOutcome(shot, None, format_error(error, for_page=job.for_page)))
    good = [one for one in ran if one.run is not None]
    if good:
        _merge_tables(clip, good, folder, options)
    return ran


def _merge_tables(clip: Path, ran: Sequence[ShotOutcome], folder: Path, options: RunOptions) -> None:
    """Write the merged tables, and a scene.json that lists the shots."""
    for name in MERGED_TABLES:
        with replace_file(folder / name) as path, path.open("w", encoding="utf-8", newline="") as file:
            file.writelines(_read_lines_of_shots(ran, folder, name))
    scene = json.loads((folder / ran[0].shot.name / "scene.json").read_text(encoding="utf-8"))
    scene["shots"] = [
        {
            "shot": one.shot.number, "folder": one.shot.name, "first": one.shot.first, "stop": one.shot.stop,
            "begins": float(one.shot.clip.t[0]), "trust": one.run.trust.level if one.run else "",
        }
        for one in ran
    ]  # fmt: skip
    write_text(folder / "scene.json", json.dumps(scene, indent=1, allow_nan=False))
    write_source(clip, folder, options)


def _read_lines_of_shots(ran: Sequence[ShotOutcome], folder: Path, name: str) -> Iterator[str]:
    """Yield one header and the lines of one table of all shots, with the number of the shot in the first column."""
    for k, one in enumerate(ran):
        with (folder / one.shot.name / name).open(encoding="utf-8", newline="") as file:
            head = next(file)
            if k == 0:
                yield head
            for line in file:
                yield f"{one.shot.number},{line.partition(',')[2]}"
