"""Dask clusters: one of this machine, or one that exists, whose workers must see our folders."""

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
from pipeline.engine.atomic_write import clear_left, own_end
from pipeline.engine.result_cache import Cache

LOOPBACK = "127.0.0.1"
ANSWER_S = 10.0
"""s for a scheduler to answer."""
SCRATCH = "trueroll"
"""Dask's folder among the temporary ones, named as `publish` tells what was left."""
COME_S = 30.0
"""s for the first worker to come to a scheduler that has just begun."""


@contextmanager
def local_client(jobs: int) -> Iterator[Client]:
    """A cluster within this process, each of whose threads has a process of its own run a clip.

    Dask's pages of itself cannot be left out; nobody but this machine can ask for them.
    """
    _be_quiet()
    clear_left(Path(tempfile.gettempdir()), SCRATCH)
    with tempfile.TemporaryDirectory(prefix=f".{SCRATCH}.", suffix=own_end()) as scratch:
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
                clip_processes.end_all()


@contextmanager
def remote_client(address: str) -> Iterator[Client]:
    """A scheduler that exists; OptionError where none answers."""
    _be_quiet()
    try:
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise OptionError(
            f"--cluster is the address of a Dask scheduler, such as tcp://host:8786; none answers at {address}"
        ) from error
    try:
        yield client
    finally:
        with suppress(OSError, TimeoutError):  # the cluster may be gone
            if client.status == "running":
                client.run(clip_processes.end_all, on_error="return")
        client.close(timeout=ANSWER_S)


def check_workers(client: Client, cache: Cache, out: Path, clip: Path) -> None:
    """OptionError unless there are workers, and each sees cache, results and clips as we do and has our code."""
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=COME_S)
    if not client.nthreads():
        raise OptionError("The Dask scheduler has no worker; start one with: dask worker ADDRESS --nthreads 1")
    probe, end = f".probe-{uuid4().hex}", own_end()  # as `publish` tells what was left
    ours = out / f"{probe}{end}"
    out.mkdir(parents=True, exist_ok=True)
    ours.touch()
    try:
        for place in client.nthreads():
            name = f"{probe}-{uuid4().hex}{end}"
            seen = _ask(client, place, str(cache.root.absolute()), str(ours.absolute()), str(clip.absolute()), name)
            if seen is not None:
                judge(place, seen, cache, name, out, clip)
    finally:
        ours.unlink(missing_ok=True)
        for left in (cache.root / "building").glob(f"{probe}*"):
            left.unlink(missing_ok=True)


def _ask(client: Client, place: str, *words: str) -> object | None:
    """What a worker sees, or the error that kept it from looking; None where it is gone meanwhile."""
    try:
        answers = client.run(dask_worker.look_around, *words, workers=[place], on_error="return")
    except (OSError, ValueError, TimeoutError) as error:
        answers = {place: error}
    seen: object | None = answers.get(place)
    lost = isinstance(seen, OSError | TimeoutError) and place not in client.nthreads()
    return None if lost else seen


def judge(place: str, seen: object, cache: Cache, probe: str, out: Path, clip: Path) -> None:
    """OptionError where what a worker saw, or what kept it from looking, says that it cannot take part."""
    if not isinstance(seen, dict):
        words = " ".join(str(seen).split())[:200]
        raise OptionError(f"The worker {place} cannot run clips ({words}); install the same trueroll there")
    if seen["code"] != dask_worker.code():
        raise OptionError(f"The worker {place} has another version of trueroll or of its libraries; install the same")
    if seen["mark"] != cache.mark or not (cache.root / "building" / probe).exists():
        raise OptionError(
            f"The worker {place} does not share the cache {cache.root}; name a folder with --cache that all can write"
        )
    if not seen["out"]:
        raise OptionError(f"The worker {place} does not share the folder {out}; name one with -o that all can write")
    if seen["clip"] != clip.stat().st_size:
        raise OptionError(f"The worker {place} does not see the clip {clip}; give a folder that all can read")


def _be_quiet() -> None:
    """Dask warns of much that is no fault here, such as a process that computes for long; what matters is in rows.

    Nor does it watch itself here as closely as it likes to, a hundred times a second: clips take seconds, and that
    takes 4 % of a processor, now 1 %.
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
