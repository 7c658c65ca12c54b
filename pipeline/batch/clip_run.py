"""One clip of a batch from its job to its row: whatever is wrong with it becomes a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from pipeline.batch.clip_job import Job, Row, failed
from pipeline.batch.long_clip import run_shots, shots_of
from pipeline.chain import Run, run_clip
from pipeline.engine.atomic_write import clear_left
from pipeline.engine.result_cache import Cache
from pipeline.engine.source_fingerprint import Look
from pipeline.engine.stage_graph import Watcher
from pipeline.reporting.text.sentences import one_sentence

CODE = Look()
"""The code that this process runs: what is edited while it runs counts for the next one."""
LIGHTS = ("green", "amber", "red")


class ShotWatcher(Watcher, Protocol):
    """A watcher who is told of the shots of a long recording too."""

    def shot(self, number: int, count: int) -> None:
        """A shot begins."""
        ...


class Counted:
    """A watcher that hands on what it hears, and remembers whether anything had to be made."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self.started = watcher.started
        self.cached = True

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        self.cached &= cached
        self._watcher.finished(stage, seconds, cached)


def run_job(job: Job, watcher: ShotWatcher) -> Row:
    """Run the clip; never raises for what a clip, a disk or a cache can do to us."""
    try:
        return _run(job, watcher)
    except Exception as error:  # whatever is wrong with one clip, the others are not to suffer
        return failed(job.name, one_sentence(error))


def _run(job: Job, watcher: ShotWatcher) -> Row:
    cache, counted = Cache(Path(job.cache), mark=job.mark), Counted(watcher)
    clip, folder, options = Path(job.clip), Path(job.folder), job.options
    clear_left(folder)
    shots = shots_of(clip, options, cache, counted, CODE)
    if not shots:
        run = run_clip(clip, folder, options, cache, counted, look=CODE)
        return _row(job, [(0.0, run)], "", counted.cached)
    ran = run_shots(clip, shots, folder, options, cache, counted, CODE, watcher.shot)
    good = [(one.shot.clip.begins, one.run) for one in ran if one.run is not None]
    bad = [one for one in ran if one.run is None]
    if not good:
        return failed(job.name, f"none of {len(ran)} shots could be used; the first: {bad[0].sentence}")
    told = f"{len(bad)} of {len(ran)} shots could not be used; {bad[0].shot.name}: {bad[0].sentence}" if bad else ""
    return _row(job, good, told, counted.cached, in_shots=True)


def _row(job: Job, runs: list[tuple[float, Run]], sentence: str, cached: bool, *, in_shots: bool = False) -> Row:
    """Of runs with the moment (s) at which each begins in the clip."""
    light = max((run.trust.light for _, run in runs), key=LIGHTS.index)
    contacts = sum(kind in ("ball", "cushion") for _, run in runs for kind in run.events.kind)
    last = max(begins + float(np.max(run.events.t, initial=-begins)) for begins, run in runs)
    return Row(
        job.name, "done", light, contacts, round(last, 3), job.folder, sentence, shots=len(runs), cached=cached,
        in_shots=in_shots,
    )  # fmt: skip
