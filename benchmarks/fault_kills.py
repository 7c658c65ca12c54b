"""Kills at random moments: processes of a batch, and of a scheduler with two workers."""

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
from fault_runs import Place, contents, entries, environment, gone, leftovers, torn, tree

START_S = 300.0
"""s for a scheduler to start: a machine that is full of other work lets it wait."""


class Crew:
    """Who runs the clips besides the batch itself: nobody."""

    def arguments(self) -> list[str]:
        return ["--jobs", "2"]

    def victims(self) -> list[tuple[psutil.Process, str]]:
        return []

    def mend(self) -> None:
        return None


class Dask(Crew):
    """A scheduler and two workers over TCP on loopback; what is killed is started again."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.mend()

    def arguments(self) -> list[str]:
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return ["--cluster", self.address]
            self.mend()  # one that was killed may have died only now
            time.sleep(0.2)
        raise SystemExit("the scheduler did not start")

    def victims(self) -> list[tuple[psutil.Process, str]]:
        found = []
        for name, process in self.processes.items():
            kinds = ["scheduler"] if name == "scheduler" else ["worker", "its process"]
            found += [(one, kinds[min(k, len(kinds) - 1)]) for k, one in enumerate(tree(process))]
        return found

    def mend(self) -> None:
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
            for one in reversed(tree(process)):
                with suppress(psutil.NoSuchProcess):
                    one.kill()
            process.wait()


@dataclass
class Toll:
    """What came of the kills."""

    killed: Counter[str] = field(default_factory=Counter)
    torn: set[str] = field(default_factory=set)
    again: set[str] = field(default_factory=set)
    """Finished stages that were made again."""
    survivors: int = 0
    """Processes that lived on after their batch was killed."""
    rounds: int = 1
    status: int = -1
    differing: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    seconds: float = 0.0


def disturbed(
    folder: Path,
    kills: int,
    rng: np.random.Generator,
    whole: dict[str, str],
    stages: dict[str, int],
    pace: float,
    cluster: bool,
    longest: float,
) -> Toll:
    """A batch that is killed so many times, or for `longest` s, begun again as often, and at last left alone once.

    `pace` is how long a clip takes on this machine today, s: moments are drawn from that.
    """
    place, toll, began = Place(folder, "killed-tcp" if cluster else "killed"), Toll(), time.monotonic()
    with _cluster() if cluster else _alone() as crew:
        seen: dict[str, int] = {}
        while sum(toll.killed.values()) < kills and time.monotonic() < began + longest:
            if _is_finished(place, stages):
                _judge(toll, place, whole, seen)
                shutil.rmtree(place.folder / place.name)
                seen, toll.rounds = {}, toll.rounds + 1
            _one_batch(place, kills, rng, pace, toll, crew, began + longest)
            _judge(toll, place, whole, seen)
        toll.status, _, _ = place.run(*crew.arguments())
    _judge(toll, place, whole, seen)
    after = contents(place)
    toll.differing = sorted(name for name in whole.keys() | after.keys() if whole.get(name) != after.get(name))
    toll.left, toll.seconds = leftovers(place), time.monotonic() - began
    return toll


def _one_batch(
    place: Place, kills: int, rng: np.random.Generator, pace: float, toll: Toll, crew: Crew, until: float
) -> None:
    """Run until the main process is gone, by a kill or at its end, or until enough was killed."""
    process = place.start(*crew.arguments())
    while process.poll() is None and sum(toll.killed.values()) < kills and time.monotonic() < until:
        with suppress(subprocess.TimeoutExpired):
            process.wait(float(rng.uniform(0.0, pace)))
            break
        family = tree(process)
        victims = [(one, "main" if one.pid == process.pid else "its process") for one in family]
        victims += crew.victims()
        victim, kind = victims[int(rng.integers(len(victims)))]
        with suppress(psutil.NoSuchProcess):
            victim.kill()
            toll.killed[kind] += 1
        if kind == "main":
            process.wait()
            toll.survivors += not gone(family)
        crew.mend()
    if process.poll() is None:
        process.kill()
    process.communicate()


def _is_finished(place: Place, stages: dict[str, int]) -> bool:
    return len(entries(place.cache)) >= len(stages)


def _judge(toll: Toll, place: Place, whole: dict[str, str], seen: dict[str, int]) -> None:
    """Hold what lies there against the undisturbed run and against what was finished before."""
    toll.torn.update(torn(place, whole))
    now = entries(place.cache)
    toll.again.update(key for key, number in seen.items() if now.get(key) != number)
    seen.update(now)


@contextmanager
def _alone() -> Iterator[Crew]:
    yield Crew()


@contextmanager
def _cluster() -> Iterator[Crew]:
    crew = Dask()
    try:
        yield crew
    finally:
        crew.close()
