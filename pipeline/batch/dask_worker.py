"""What a Dask worker does with a clip: it has it run by a process of its own, and tells how far it is."""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import get_worker

from pipeline.batch.clip_job import Job
from pipeline.batch.clip_processes import mine
from pipeline.engine.result_cache import MARK
from pipeline.engine.source_fingerprint import library_versions, source_hashes

PAUSE_S = 0.5
"""s between two words about a clip that go through the scheduler."""


def run_here(text: str, topic: str) -> str:
    """A job to a row, both as text, on one of this worker's threads."""
    job = Job.from_text(text)
    worker, last = get_worker(), 0.0

    def heard(word: dict[str, Any]) -> None:
        nonlocal last
        if time.monotonic() - last >= PAUSE_S or "shot" in word:
            last = time.monotonic()
            worker.log_event(topic, {"name": job.name, **word})

    worker.log_event(topic, {"name": job.name, "stage": "begins", "share": 0.0})
    return mine().run(job, heard).as_text()


def look_around(cache: str, ours: str, clip: str, probe: str) -> dict[str, Any]:
    """What a worker sees of the folders that all must share, and which code it has.

    It leaves `probe` in the cache; `ours` is a file in the folder of the results.
    """
    seen: dict[str, Any] = {"code": code(), "mark": None, "out": False, "clip": None}
    with suppress(OSError, ValueError):
        seen["mark"] = (Path(cache) / MARK).read_text(encoding="ascii")
        (Path(cache) / "building" / probe).touch()
    with suppress(OSError):
        seen["out"] = Path(ours).exists() and os.access(Path(ours).parent, os.W_OK)
    with suppress(OSError):
        seen["clip"] = Path(clip).stat().st_size
    return seen


def code() -> str:
    """One hash of all the code that runs a clip, and of the libraries that can change a result."""
    facts = sorted(source_hashes("pipeline.batch.clip_run").items()), sorted(library_versions().items())
    return hashlib.sha256(repr(facts).encode()).hexdigest()
