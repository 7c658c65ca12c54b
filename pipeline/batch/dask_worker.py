"""Functions that run on a Dask worker: it runs a clip in a supervised process and reports the progress."""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import get_worker

from pipeline.batch.clip_job import ClipJob
from pipeline.batch.clip_processes import thread_process
from pipeline.engine.result_cache import MARK
from pipeline.engine.source_fingerprint import hash_sources, library_versions

MESSAGE_INTERVAL_S = 0.5
"""Least time between two progress messages of a clip, which go through the scheduler, s."""


def run_job_on_worker(text: str, topic: str) -> str:
    """Run a clip on a thread of this worker.

    Args:
        text: The job as JSON.
        topic: Dask topic of the progress messages.

    Returns:
        The result as JSON.
    """
    job = ClipJob.from_json(text)
    worker, last = get_worker(), 0.0

    def forward_message(message: dict[str, Any]) -> None:
        nonlocal last
        if time.monotonic() - last >= MESSAGE_INTERVAL_S or "shot" in message:
            last = time.monotonic()
            worker.log_event(topic, {"name": job.name, **message})

    worker.log_event(topic, {"name": job.name, "stage": "begins", "share": 0.0})
    return thread_process().run(job, forward_message).to_json()


def probe_folders(cache: str, ours: str, clip: str, probe: str) -> dict[str, Any]:
    """Report which of the shared folders this worker sees, and which code it has.

    Args:
        cache: Folder of the cache.
        ours: A file in the folder of the results.
        clip: A clip, or the folder of the batch.
        probe: Name of the file to leave in the cache.

    Returns:
        Hash of the code, mark of the cache, whether the results can be written, size of the clip (None if not seen).
    """
    answer: dict[str, Any] = {"code": hash_code(), "mark": None, "out": False, "clip": None}
    with suppress(OSError, ValueError):
        answer["mark"] = (Path(cache) / MARK).read_text(encoding="ascii")
        (Path(cache) / "building" / probe).touch()
    with suppress(OSError):
        answer["out"] = Path(ours).exists() and os.access(Path(ours).parent, os.W_OK)
    with suppress(OSError):
        answer["clip"] = Path(clip).stat().st_size
    return answer


def hash_code() -> str:
    """Return one hash of all code that runs a clip and of the versions of the libraries."""
    facts = sorted(hash_sources("pipeline.batch.clip_run").items()), sorted(library_versions().items())
    return hashlib.sha256(repr(facts).encode()).hexdigest()
