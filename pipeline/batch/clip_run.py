"""Runs one clip of a batch from its job to its result; every error becomes a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from models.numerics.jit import measure_compilation
from pipeline.batch.clip_job import ClipJob, ClipResult, build_failed_result, format_duration
from pipeline.batch.disk_room import FilmLength, describe_room, estimate_bytes
from pipeline.batch.long_clip import run_shots
from pipeline.chain import FinishedRun, run_clip
from pipeline.engine.atomic_write import remove_leftovers
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage_graph import RunWatcher
from pipeline.recording_shots import find_recording_shots
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import RunOptions
from pipeline.stages.kernel_preparation import KernelPreparation
from pipeline.stages.read_stage import open_frame_memory
from pipeline.stages.shot_stages import ClipShot

# The project's code that this process runs; a later edit counts for the next process.
SNAPSHOT = SourceSnapshot()
TRUST_LEVELS = ("green", "amber", "red")


class ShotWatcher(RunWatcher, Protocol):
    """A watcher that also follows the shots of a long recording."""

    def start_shot(self, number: int, count: int, done: float) -> None:
        """Note that shot `number` of `count` begins, and which share of all of them is done."""
        ...

    def write_note(self, sentence: str) -> None:
        """Pass on a sentence for the user."""
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
            result = build_failed_result(job.name, format_error(error))
        return replace(result, compiling=round(measure(), 3))


def _run_clip_or_shots(job: ClipJob, watcher: ShotWatcher) -> ClipResult:
    """Run a clip as a whole, or each of its shots if it is a long recording."""
    cache, counted = ResultCache(Path(job.cache), mark=job.mark), CacheUseWatcher(watcher)
    clip, folder, options = Path(job.clip), Path(job.folder), job.options
    remove_leftovers(folder)
    with open_frame_memory() as memory:
        shots = find_recording_shots(clip, options, cache, counted, SNAPSHOT, memory).shots
        if not shots:
            with KernelPreparation() as kernels:
                run = run_clip(
                    clip, folder, options, cache, counted, snapshot=SNAPSHOT, start_helpers=kernels.start, memory=memory
                )
            return _summarize_runs(job, [run], "", counted.cached)
    watcher.write_note(f"{job.name}: {_plan_shots(shots, folder, cache, options)}")
    ran = run_shots(clip, shots, folder, options, cache, counted, SNAPSHOT, watcher.start_shot)
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
    job: ClipJob, runs: list[FinishedRun], sentence: str, cached: bool, *, in_shots: bool = False
) -> ClipResult:
    """Summarize the runs of a clip."""
    light = max((run.fit.trust.level for run in runs), key=TRUST_LEVELS.index)
    contacts = sum(kind in ("ball", "cushion") for run in runs for kind in run.fit.events.kind)
    last = max(float(np.max(run.fit.events.t, initial=0.0)) for run in runs)
    return ClipResult(
        job.name, "done", light, contacts, round(last, 3), job.folder, sentence, shots=len(runs), cached=cached,
        in_shots=in_shots,
    )  # fmt: skip
