"""Kill processes of a batch, and of a scheduler with two workers, at random moments."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from benchmarks.pipeline.fault_runs import (
    BatchFolder,
    environment,
    find_leftovers,
    find_torn_files,
    hash_contents,
    process_tree,
    read_manifests,
    wait_for_end,
)

# Seconds a scheduler may take to start on a busy machine.
START_S = 300.0


class LocalWorkers:
    """Two local worker processes of the batch itself."""

    def arguments(self) -> list[str]:
        return ["--jobs", "2"]

    def victims(self) -> list[tuple[psutil.Process, str]]:
        return []

    def restart_killed(self) -> None:
        return None


class DaskCluster(LocalWorkers):
    """A scheduler and two workers over TCP on loopback; killed processes are started again."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.restart_killed()

    def arguments(self) -> list[str]:
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return ["--cluster", self.address]
            self.restart_killed()  # a killed process may have ended only now
            time.sleep(0.2)
        raise SystemExit("the scheduler did not start")

    def victims(self) -> list[tuple[psutil.Process, str]]:
        processes = []
        for name, process in self.processes.items():
            kinds = ["scheduler"] if name == "scheduler" else ["worker", "its process"]
            processes += [(one, kinds[min(k, len(kinds) - 1)]) for k, one in enumerate(process_tree(process))]
        return processes

    def restart_killed(self) -> None:
        home = ["--host", "127.0.0.1"]
        scheduler = ["scheduler", *home, "--port", str(self.port), "--no-dashboard"]
        worker = ["worker", self.address, *home, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        for name, words in (("scheduler", scheduler), ("worker 1", worker), ("worker 2", worker)):
            process = self.processes.get(name)
            if process is None or process.poll() is not None:
                self.processes[name] = subprocess.Popen(
                    [sys.executable, "-m", "dask", *words], env=environment() | {"PYTHONWARNINGS": "ignore"},
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True,
                )  # fmt: skip

    def close(self) -> None:
        for process in reversed(self.processes.values()):
            for one in reversed(process_tree(process)):
                with suppress(psutil.NoSuchProcess):
                    one.kill()
            process.wait()


@dataclass
class KillReport:
    """Result of a batch with kills."""

    killed: Counter[str] = field(default_factory=Counter)
    torn_files: set[str] = field(default_factory=set)
    repeated_stages: set[str] = field(default_factory=set)
    """Finished stages that were computed again."""
    survivors: int = 0
    """Batches whose processes survived the kill of the main process."""
    rounds: int = 1
    status: int = -1
    differing: list[str] = field(default_factory=list)
    leftovers: list[str] = field(default_factory=list)
    seconds: float = 0.0


def run_with_kills(
    folder: Path,
    kills: int,
    rng: np.random.Generator,
    whole: dict[str, str],
    stages: dict[str, int],
    pace: float,
    cluster: bool,
    longest: float,
) -> KillReport:
    """Run a batch with `kills` kills, or for `longest` s, restart it each time, and finally let it finish.

    `pace` is the duration of a clip on this machine, s; the moments of the kills are drawn from it.
    """
    place, report, began = BatchFolder(folder, "killed-tcp" if cluster else "killed"), KillReport(), time.monotonic()
    with _dask_cluster() if cluster else _local_workers() as workers:
        manifests: dict[str, int] = {}
        while sum(report.killed.values()) < kills and time.monotonic() < began + longest:
            if _is_finished(place, stages):
                _check_files(report, place, whole, manifests)
                shutil.rmtree(place.folder / place.name)
                manifests, report.rounds = {}, report.rounds + 1
            _run_one_batch(place, kills, rng, pace, report, workers, began + longest)
            _check_files(report, place, whole, manifests)
        report.status, _, _ = place.run(*workers.arguments())
    _check_files(report, place, whole, manifests)
    after = hash_contents(place)
    report.differing = sorted(name for name in whole.keys() | after.keys() if whole.get(name) != after.get(name))
    report.leftovers, report.seconds = find_leftovers(place), time.monotonic() - began
    return report


def _run_one_batch(
    place: BatchFolder,
    kills: int,
    rng: np.random.Generator,
    pace: float,
    report: KillReport,
    workers: LocalWorkers,
    until: float,
) -> None:
    """Run until the main process has ended or was killed, or until the number of kills is reached."""
    process = place.start(*workers.arguments())
    while process.poll() is None and sum(report.killed.values()) < kills and time.monotonic() < until:
        with suppress(subprocess.TimeoutExpired):
            process.wait(float(rng.uniform(0.0, pace)))
            break
        family = process_tree(process)
        victims = [(one, "main" if one.pid == process.pid else "its process") for one in family]
        victims += workers.victims()
        victim, kind = victims[int(rng.integers(len(victims)))]
        with suppress(psutil.NoSuchProcess):
            victim.kill()
            report.killed[kind] += 1
        if kind == "main":
            process.wait()
            report.survivors += not wait_for_end(family)
        workers.restart_killed()
    if process.poll() is None:
        process.kill()
    process.communicate()


def _is_finished(place: BatchFolder, stages: dict[str, int]) -> bool:
    return len(read_manifests(place.cache)) >= len(stages)


def _check_files(report: KillReport, place: BatchFolder, whole: dict[str, str], manifests: dict[str, int]) -> None:
    """Compare the files on disk with the undisturbed run and with the stages finished before."""
    report.torn_files.update(find_torn_files(place, whole))
    now = read_manifests(place.cache)
    report.repeated_stages.update(key for key, number in manifests.items() if now.get(key) != number)
    manifests.update(now)


@contextmanager
def _local_workers() -> Iterator[LocalWorkers]:
    yield LocalWorkers()


@contextmanager
def _dask_cluster() -> Iterator[LocalWorkers]:
    workers = DaskCluster()
    try:
        yield workers
    finally:
        workers.close()
