"""Dask clusters: starts one on this machine, or connects to one whose workers must share the folders of the batch."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import dask
from distributed import Client, Scheduler, SpecCluster, Worker

from models.core.errors import OptionError
from pipeline.batch import clip_processes, dask_worker
from pipeline.engine.atomic_write import part_suffix, remove_leftovers
from pipeline.engine.result_cache import ResultCache

LOOPBACK = "127.0.0.1"
CONNECT_TIMEOUT_S = 10.0
"""Time for a scheduler to answer, s."""
SCRATCH_NAME = "trueroll"
"""Dask's folder below the temporary folder; `atomic_write` recognises leftovers by its name."""
WORKER_TIMEOUT_S = 30.0
"""Time for the first worker to connect to a scheduler that has just started, s."""


@contextmanager
def start_local_client(jobs: int) -> Iterator[Client]:
    """Start a cluster within this process; each of its threads supervises a process that runs a clip.

    Dask's dashboard cannot be turned off; it is reachable from this machine only.

    Args:
        jobs: Number of threads.

    Yields:
        A client of the cluster.
    """
    _quiet_dask()
    remove_leftovers(Path(tempfile.gettempdir()), SCRATCH_NAME)
    with tempfile.TemporaryDirectory(prefix=f".{SCRATCH_NAME}.", suffix=part_suffix()) as scratch:
        common = {
            "protocol": "inproc",
            "dashboard": False,
            "dashboard_address": f"{LOOPBACK}:0",
            "local_directory": scratch,
        }
        worker_options = common | {"nthreads": jobs, "memory_limit": 0}
        with (
            SpecCluster(
                scheduler={"cls": Scheduler, "options": common},
                workers={0: {"cls": Worker, "options": worker_options}},
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            try:
                yield client
            finally:
                clip_processes.end_processes()


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
                client.run(clip_processes.end_processes, on_error="return")
        client.close(timeout=CONNECT_TIMEOUT_S)


def require_usable_workers(client: Client, cache: ResultCache, out: Path, clip: Path) -> None:
    """Require that there are workers, and that each has the same code and shares all folders.

    Args:
        client: Client of the cluster.
        cache: The cache.
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
            answer = _probe_worker(
                client, worker, str(cache.root.absolute()), str(ours.absolute()), str(clip.absolute()), name
            )
            if answer is not None:
                require_usable_answer(worker, answer, cache, name, out, clip)
    finally:
        ours.unlink(missing_ok=True)
        for left in (cache.root / "building").glob(f"{probe}*"):
            left.unlink(missing_ok=True)


def _probe_worker(client: Client, worker: str, *words: str) -> object | None:
    """Return the answer of a worker, or the error that it raised; None if it has disconnected."""
    try:
        answers = client.run(dask_worker.probe_folders, *words, workers=[worker], on_error="return")
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
        cache: The cache.
        probe: Name of the file that the worker left in the cache.
        out: Folder of the results.
        clip: A clip, or the folder of the batch.

    Raises:
        OptionError: The worker cannot run clips of this batch.
    """
    if not isinstance(answer, dict):
        words = " ".join(str(answer).split())[:200]
        raise OptionError(f"The worker {worker} cannot run clips ({words}); install the same trueroll there")
    if answer["code"] != dask_worker.hash_code():
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
