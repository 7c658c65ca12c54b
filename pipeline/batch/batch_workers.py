"""Who runs the clips of a batch: one process, or the workers of a Dask cluster, here or elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from models.core.errors import TruerollError
from pipeline.batch.clip_job import Job, Row, failed
from pipeline.batch.supervision import Supervised

if TYPE_CHECKING:
    from distributed import Client, Future

Jobs = Iterator[Job | None]
"""None: there may be more later."""
Heard = Callable[[str, dict[str, Any]], None]
"""Hears the name of a clip and how far it is."""
Crew = Callable[[Jobs, Heard], Iterator[Row]]
"""Runs clips; rows come as they are done."""
IDLE_S = 0.5
"""s to wait where nothing is to be done yet."""
AHEAD = 2
"""Clips per worker that are handed out: the next one lies there when one is done, and no more are held."""
LOST_S = 30.0
"""s without a word from the scheduler after which it is given up."""


class SchedulerLost(TruerollError):
    """The scheduler is gone, and with it the clips that were handed out."""


def one_after_another(jobs: Jobs, heard: Heard) -> Iterator[Row]:
    """Run clips in one process."""
    with Supervised() as process:
        for job in jobs:
            if job is None:
                time.sleep(IDLE_S)
            else:
                yield process.run(job, partial(heard, job.name))


def by_workers(client: Client, jobs: Jobs, heard: Heard) -> Iterator[Row]:
    """Run clips on the workers of a cluster, each a task; rows come as they are done.

    A worker that is lost loses no clip: the scheduler gives it to another, and gives up after its own number of
    losses. SchedulerLost where there is none any more.
    """
    topic = f"trueroll-{uuid4().hex}"
    client.subscribe_topic(topic, lambda event: _hand_on(heard, event))
    running: dict[Future, Job] = {}
    number, more = 0, True
    try:
        while more or running:
            more = more and _hand_out(client, jobs, running, topic, number)
            number += 1
            for future in _done(client, running):
                yield _row(future, running.pop(future))
            if more and not running:
                time.sleep(IDLE_S)
    except OSError as error:  # of a connection: no file is touched here
        raise SchedulerLost("The Dask scheduler is gone; run again once it is back: what is done is kept") from error
    finally:
        if client.status == "running":
            client.cancel(list(running))
            client.unsubscribe_topic(topic)


def _hand_out(client: Client, jobs: Jobs, running: dict[Future, Job], topic: str, number: int) -> bool:
    """Submit as many clips as the workers can take soon; False where there are no more."""
    from pipeline.batch.dask_worker import run_here  # Dask is slow to import, and not needed where no workers are

    room = AHEAD * max(sum(client.nthreads().values()), 1) - len(running)
    for k in range(room):
        try:
            job = next(jobs)
        except StopIteration:
            return False
        if job is None:
            return True
        key = f"{topic}-{number}-{k}"
        running[client.submit(run_here, job.as_text(), topic, key=key, pure=False)] = job
    return True


def _done(client: Client, running: dict[Future, Job]) -> list[Future]:
    """Those that have ended, after a moment."""
    from distributed import wait

    if running:
        with suppress(TimeoutError), client.as_current():
            wait(list(running), timeout=IDLE_S, return_when="FIRST_COMPLETED")
        if client.status != "running":
            raise SchedulerLost("The Dask scheduler is gone; run again once it is back: what is done is kept")
    return [future for future in running if future.done()]


def _row(future: Future, job: Job) -> Row:
    if future.status == "finished":
        return Row.from_text(future.result())
    if future.status in ("cancelled", "lost"):
        raise SchedulerLost("The Dask scheduler lost its clips; run again once it is back: what is done is kept")
    error = future.exception()
    return failed(job.name, f"{job.name}: {type(error).__name__}: {' '.join(str(error).split())[:300]}")


def _hand_on(heard: Heard, event: tuple[float, dict[str, Any]]) -> None:
    word = event[1]
    heard(word["name"], word)
