"""A Dask cluster whose workers share the folders of a batch: connects to it and runs clips there.

Clips need time limits, memory limits and retries, which the executors of `models.numerics.executor` do not have.
"""

from __future__ import annotations

import hashlib
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import dask
from distributed import Client, Future, get_worker, wait

from models.core.errors import OptionError, TruerollError
from pipeline.batch import supervision
from pipeline.batch.clip_job import ClipJob, ClipResult, JobStream, ProgressListener, build_failed_result
from pipeline.batch.supervision import IDLE_S, thread_process
from pipeline.engine.atomic_write import part_suffix
from pipeline.engine.result_cache import MARK, ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions

# Time for a scheduler to answer, s.
CONNECT_TIMEOUT_S = 10.0
# Time for the first worker to connect to a scheduler that has just started, s.
WORKER_TIMEOUT_S = 30.0


@contextmanager
def connect_client(address: str) -> Iterator[Client]:
    """Connect to an existing scheduler.

    Args:
        address: Address such as tcp://host:8786.

    Yields:
        A client of the cluster.

    Raises:
        OptionError: No scheduler answers.
    """
    _quiet_dask()
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise OptionError(
            f"--cluster is the address of a Dask scheduler, such as tcp://host:8786; none answers at {address}"
        ) from error
    try:
        yield client
    finally:
        with suppress(OSError, TimeoutError):  # the cluster may be gone
            if client.status == "running":
                client.run(supervision.end_processes, on_error="return")
        client.close(timeout=CONNECT_TIMEOUT_S)


def require_usable_workers(client: Client, cache: ResultCache, out: Path, clip: Path) -> None:
    """Require that there are workers, and that each has the same code and shares all folders.

    Args:
        client: Client of the cluster.
        out: Folder of the results.
        clip: A clip, or the folder of the batch.

    Raises:
        OptionError: There is no worker, or one lacks something.
    """
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
    if not client.nthreads():
        raise OptionError("The Dask scheduler has no worker; start one with: dask worker ADDRESS --nthreads 1")
    probe, end = f".probe-{uuid4().hex}", part_suffix()  # recognised by `atomic_write`
    ours = out / f"{probe}{end}"
    out.mkdir(parents=True, exist_ok=True)
    ours.touch()
    try:
        for worker in client.nthreads():
            name = f"{probe}-{uuid4().hex}{end}"
            answer = _probe_worker(client, worker, *(str(one.absolute()) for one in (cache.root, ours, clip)), name)
            if answer is not None:
                require_usable_answer(worker, answer, cache, name, out, clip)
    finally:
        ours.unlink(missing_ok=True)
        for left in (cache.root / "building").glob(f"{probe}*"):
            left.unlink(missing_ok=True)


def _probe_worker(client: Client, worker: str, *words: str) -> object | None:
    """Return the answer of a worker, or the error that it raised; None if it has disconnected."""
    try:
        answers = client.run(probe_folders, *words, workers=[worker], on_error="return")
    except (OSError, ValueError, TimeoutError) as error:
        answers = {worker: error}
    answer: object | None = answers.get(worker)
    lost = isinstance(answer, OSError | TimeoutError) and worker not in client.nthreads()
    return None if lost else answer


def require_usable_answer(worker: str, answer: object, cache: ResultCache, probe: str, out: Path, clip: Path) -> None:
    """Require that the answer of a worker shows the same code and shared folders.

    Args:
        worker: Address of the worker.
        answer: What `probe_folders` returned there, or an exception.
        probe: Name of the file that the worker left in the cache.
        out: Folder of the results.
        clip: A clip, or the folder of the batch.

    Raises:
        OptionError: The worker cannot run clips of this batch.
    """
    if not isinstance(answer, dict):
        words = " ".join(str(answer).split())[:200]
        raise OptionError(f"The worker {worker} cannot run clips ({words}); install the same trueroll there")
    if answer["code"] != hash_code():
        raise OptionError(f"The worker {worker} has another version of trueroll or of its libraries; install the same")
    if answer["mark"] != cache.mark or not (cache.root / "building" / probe).exists():
        raise OptionError(
            f"The worker {worker} does not share the cache {cache.root}; name a folder with --cache that all can write"
        )
    if not answer["out"]:
        raise OptionError(f"The worker {worker} does not share the folder {out}; name one with -o that all can write")
    if answer["clip"] != clip.stat().st_size:
        raise OptionError(f"The worker {worker} does not see the clip {clip}; give a folder that all can read")


def _quiet_dask() -> None:
    """Silence Dask's warnings and let it monitor itself rarely.

    It warns of much that is no fault here, such as long computations. Its own monitoring takes 4 % of a core by
    default, 1 % with these settings (measured); clips take seconds, so nothing is lost.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    os.environ.setdefault("DASK_DISTRIBUTED__LOGGING__DISTRIBUTED", "critical")
    dask.config.set(
        {
            "distributed.comm.timeouts.connect": "10s",
            "distributed.comm.retry.count": 1,
            "distributed.worker.profile.enabled": False,
            "distributed.admin.tick.interval": "500ms",
            "distributed.admin.system-monitor.interval": "5s",
            "distributed.admin.system-monitor.gil.enabled": False,
        }
    )


# Least time between two progress messages of a clip, which go through the scheduler, s.
MESSAGE_INTERVAL_S = 0.5


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


# Clips that are submitted per worker thread: the next one waits when one is done.
CLIPS_PER_WORKER = 2


class SchedulerLost(TruerollError):
    """The scheduler is gone, and with it the submitted clips."""


def run_on_workers(client: Client, jobs: JobStream, listener: ProgressListener) -> Iterator[ClipResult]:
    """Run clips on the workers of a cluster, each as one task.

    If a worker dies, the scheduler gives its clip to another worker, up to the scheduler's own number of retries.

    Args:
        client: Client of the cluster.
        jobs: Clips to run.
        listener: Called with progress messages.

    Yields:
        The result of each clip when it is done.

    Raises:
        SchedulerLost: The scheduler is gone.
    """
    topic = f"trueroll-{uuid4().hex}"
    client.subscribe_topic(topic, lambda event: listener(event[1]["name"], event[1]))
    running: dict[Future, ClipJob] = {}
    number, more = 0, True
    try:
        while more or running:
            more = more and _submit_jobs(client, jobs, running, topic, number)
            number += 1
            for future in _wait_for_finished(client, running):
                yield _read_result(future, running.pop(future))
            if more and not running:
                time.sleep(IDLE_S)
    except OSError as error:  # of a connection: no file is touched here
        raise SchedulerLost("The Dask scheduler is gone; run again once it is back: what is done is kept") from error
    finally:
        if client.status == "running":
            client.cancel(list(running))
            client.unsubscribe_topic(topic)


def _submit_jobs(client: Client, jobs: JobStream, running: dict[Future, ClipJob], topic: str, number: int) -> bool:
    """Submit as many clips as the workers can start soon; return False when there are no more."""
    room = CLIPS_PER_WORKER * max(sum(client.nthreads().values()), 1) - len(running)
    for k in range(room):
        try:
            job = next(jobs)
        except StopIteration:
            return False
        if job is None:
            return True
        key = f"{topic}-{number}-{k}"
        running[client.submit(run_job_on_worker, job.to_json(), topic, key=key, pure=False)] = job
    return True


def _wait_for_finished(client: Client, running: dict[Future, ClipJob]) -> list[Future]:
    """Wait briefly and return the finished futures."""
    if running:
        with suppress(TimeoutError), client.as_current():
            wait(list(running), timeout=IDLE_S, return_when="FIRST_COMPLETED")
        if client.status != "running":
            raise SchedulerLost("The Dask scheduler is gone; run again once it is back: what is done is kept")
    return [future for future in running if future.done()]


def _read_result(future: Future, job: ClipJob) -> ClipResult:
    """Read the result of a finished future; a failed one becomes a failed result."""
    if future.status == "finished":
        return ClipResult.from_json(future.result())
    if future.status in ("cancelled", "lost"):
        raise SchedulerLost("The Dask scheduler lost its clips; run again once it is back: what is done is kept")
    error = future.exception()
    return build_failed_result(job.name, f"{job.name}: {type(error).__name__}: {' '.join(str(error).split())[:300]}")
