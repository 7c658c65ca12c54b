"""Runs the clips of a batch in one process, or on the workers of a Dask cluster.

Clips need time limits, memory limits and retries, which the executors of `models.numerics.executor` do not have.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from models.core.errors import TruerollError
from pipeline.batch.clip_job import ClipJob, ClipResult, build_failed_result
from pipeline.batch.supervision import SupervisedProcess

if TYPE_CHECKING:
    from distributed import Client, Future

# Clips to run. None means that there is none now, but more may come.
JobStream = Iterator[ClipJob | None]
# Called with the name of a clip and a progress message; see `clip_runner`.
ProgressListener = Callable[[str, dict[str, Any]], None]
# Runs clips and yields each result when its clip is done.
ClipRunner = Callable[[JobStream, ProgressListener], Iterator[ClipResult]]
# Waiting time while there is no clip to run, s.
IDLE_S = 0.5
# Clips that are submitted per worker thread: the next one waits when one is done.
CLIPS_PER_WORKER = 2


class SchedulerLost(TruerollError):
    """The scheduler is gone, and with it the submitted clips."""


def run_serially(jobs: JobStream, listener: ProgressListener) -> Iterator[ClipResult]:
    """Run clips one after another in one process.

    Args:
        jobs: Clips to run.
        listener: Called with progress messages.

    Yields:
        The result of each clip.
    """
    with SupervisedProcess() as process:
        for job in jobs:
            if job is None:
                time.sleep(IDLE_S)
            else:
                yield process.run(job, partial(listener, job.name))


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
    client.subscribe_topic(topic, lambda event: _forward_message(listener, event))
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
    from pipeline.batch.dask_cluster import run_job_on_worker  # Dask is slow to import

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
    from distributed import wait

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


def _forward_message(listener: ProgressListener, event: tuple[float, dict[str, Any]]) -> None:
    """Pass a progress message of a worker on to the listener."""
    message = event[1]
    listener(message["name"], message)
