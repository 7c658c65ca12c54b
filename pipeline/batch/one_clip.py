"""One clip of a batch from its job to its row: whatever is wrong with it becomes a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.batch.job import Job, Row, failed
from pipeline.cache import Cache
from pipeline.chain import Run, run_clip
from pipeline.fingerprint import Look
from pipeline.graph import Watcher
from pipeline.publish import clear_left
from pipeline.sentences import one_sentence

CODE = Look()
"""The code that this process runs: what is edited while it runs counts for the next one."""
LIGHTS = ("green", "amber", "red")


class Counted:
    """A watcher that hands on what it hears, and remembers whether anything had to be made."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self.started = watcher.started
        self.cached = True

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        self.cached &= cached
        self._watcher.finished(stage, seconds, cached)


def run_job(job: Job, watcher: Watcher) -> Row:
    """Run the clip; never raises for what a clip, a disk or a cache can do to us."""
    try:
        cache = Cache(Path(job.cache), mark=job.mark)
        counted = Counted(watcher)
        folder = Path(job.folder)
        clear_left(folder)
        run = run_clip(Path(job.clip), folder, job.options, cache, counted, look=CODE)
    except Exception as error:  # whatever is wrong with one clip, the others are not to suffer
        return failed(job.name, one_sentence(error))
    return _row(job, run, counted.cached)


def _row(job: Job, run: Run, cached: bool) -> Row:
    contacts = sum(kind in ("ball", "cushion") for kind in run.events.kind)
    last = float(np.max(run.events.t, initial=0.0))
    return Row(job.name, "done", run.trust.light, contacts, round(last, 3), job.folder, "", cached=cached)
