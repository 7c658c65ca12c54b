"""Runs clips in separate processes, one for each thread, and kills them when a clip takes too much time or memory.

A decoder that hangs in foreign code, or a frame that takes all memory, can be stopped in no other way.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import psutil

from models.core.errors import TruerollError
from pipeline.batch import clip_runner
from pipeline.batch.clip_job import (
    MAX_TRIES,
    ClipJob,
    ClipResult,
    JobStream,
    ProgressListener,
    build_failed_result,
    format_duration,
)
from pipeline.engine.atomic_write import remove_leftovers
from pipeline.engine.result_cache import ResultCache

# Time between two checks of the memory of a process, s. At 2 GB/s it grows by 200 MB in between.
POLL_INTERVAL_S = 0.1
# Time for a process to start, s. Imports from a network disk are slow the first time.
START_TIMEOUT_S = 120.0
# Time for a process to remove unfinished files and exit, s.
EXIT_TIMEOUT_S = 3.0
# Resident memory after a clip above which the next clip gets a new process, MB.
RENEWAL_MEMORY_MB = 1500.0
# Length of the end of a dead process's error output that is read, bytes.
ERROR_TAIL_BYTES = 2000

# Called with the progress messages of a clip; see `clip_runner`.
MessageListener = Callable[[dict[str, Any]], None]


class ClipLimitExceeded(Exception):
    """A clip exceeded a limit, and its process was killed."""


class ProcessDied(Exception):
    """The process ended unexpectedly."""


@dataclass(slots=True)
class _ChildProcess:
    """A running process and its unread output."""

    process: subprocess.Popen[bytes]
    errors: IO[bytes]
    is_ready: bool = False
    unread: bytes = b""
    peak_mb: float = 0.0
    started_at: float = field(default_factory=time.monotonic)
    is_terminating: bool = False
    """Whether it was asked to exit."""

    def read_messages(self) -> list[dict[str, Any]]:
        """Read the messages since the last call, waiting briefly; raises ProcessDied at the end of the output."""
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], POLL_INTERVAL_S)[0]:
            return []
        part = os.read(self.process.stdout.fileno(), 1 << 16)
        if not part:
            raise ProcessDied(self.describe_exit())
        *lines, self.unread = (self.unread + part).split(b"\n")
        return [json.loads(line) for line in lines]

    def measure_memory_mb(self) -> float:
        """Return the resident memory now, MB; 0 if the process has ended."""
        with suppress(psutil.Error):
            now = float(psutil.Process(self.process.pid).memory_info().rss) / 1e6
            self.peak_mb = max(self.peak_mb, now)
            return now
        return 0.0

    def describe_exit(self) -> str:
        """Describe how the process ended."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(EXIT_TIMEOUT_S)
        code = self.process.returncode
        if code is not None and code < 0:
            return f"it was ended by {signal.Signals(-code).name}"
        self.errors.seek(max(self.errors.seek(0, os.SEEK_END) - ERROR_TAIL_BYTES, 0))
        last = self.errors.read().decode("utf-8", "replace").strip().rpartition("\n")[2]
        return f"it exited with status {code}" + (f": {last}" if last else "")

    def terminate_once(self) -> None:
        """Ask the process to clean up and exit, once: a second signal would interrupt the clean-up."""
        if not self.is_terminating:
            self.is_terminating = True
            self.process.terminate()

    def end(self, *, at_once: bool = False) -> None:
        """Let the process clean up and exit, or kill it `at_once`."""
        if not at_once:
            self.terminate_once()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(EXIT_TIMEOUT_S)
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


class SupervisedProcess:
    """A process that runs one clip after another, as a context manager that ends it."""

    def __init__(self) -> None:
        self._child: _ChildProcess | None = None
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def request_exit(self) -> None:
        """Ask the process to exit for good, without waiting; a running clip is not retried."""
        self._closed = True
        if (child := self._child) is not None:
            child.terminate_once()

    def close(self) -> None:
        """End the process for good, so that a running clip is not retried; any thread may call this."""
        self.request_exit()
        self.end()

    def end(self, *, at_once: bool = False) -> None:
        """End the process, if there is one."""
        child, self._child = self._child, None
        if child is not None:
            child.end(at_once=at_once)

    def run(self, job: ClipJob, listener: MessageListener) -> ClipResult:
        """Run a clip, again in a new process if the process dies, but not after a limit was exceeded.

        Args:
            job: The clip.
            listener: Called with progress messages.

        Returns:
            Its result.
        """
        began, sentence = time.monotonic(), ""
        for tries in range(1, MAX_TRIES + 1):
            try:
                row = self._attempt_job(job, listener)
                return replace(row, seconds=round(time.monotonic() - began, 3), tries=tries)
            except ClipLimitExceeded as stop:
                sentence = str(stop)
                break
            except ProcessDied as death:
                if self._closed:
                    sentence = f"{job.name} was interrupted; run again"
                    break
                sentence = f"{job.name}: the process that ran it died {tries} times; the last time {death}"
                self.end(at_once=True)
        with suppress(OSError, TruerollError):  # unfinished files of a killed process
            remove_leftovers(Path(job.folder))
            ResultCache(Path(job.cache), mark=job.mark).remove_leftovers()
        return build_failed_result(job.name, sentence, seconds=round(time.monotonic() - began, 3), tries=tries)

    def _attempt_job(self, job: ClipJob, listener: MessageListener) -> ClipResult:
        """Run a clip once; raises ProcessDied or ClipLimitExceeded."""
        child = self._ready_process()
        child.started_at, child.peak_mb = time.monotonic(), 0.0
        try:
            assert child.process.stdin is not None
            child.process.stdin.write(job.to_json().encode() + b"\n")
            child.process.stdin.flush()
        except OSError as error:
            raise ProcessDied(child.describe_exit()) from error
        while True:
            for message in child.read_messages():
                if "row" in message:
                    if child.measure_memory_mb() > RENEWAL_MEMORY_MB:  # it has grown too large for another clip
                        self.end()
                    return replace(ClipResult.from_json(message["row"]), peak_mb=round(child.peak_mb))
                if "shot" in message:
                    child.started_at = time.monotonic()
                listener(message)
            self._enforce_limits(job, child)

    def start(self) -> None:
        """Start the process if there is none, without waiting until it is ready."""
        if self._child is None:
            errors = tempfile.TemporaryFile()  # noqa: SIM115  it is closed with the process
            process = subprocess.Popen(
                clip_runner.build_command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, bufsize=0
            )
            self._child = _ChildProcess(process, errors)

    def prepare(self) -> None:
        """Start the process if there is none, and let it load what any clip needs, without waiting for either."""
        self.start()
        child = self._child
        if child is not None and child.process.stdin is not None:
            with suppress(OSError):  # it has died already; the first clip starts another one
                child.process.stdin.write(f"{clip_runner.PREPARE}\n".encode())

    def _ready_process(self) -> _ChildProcess:
        """Return the process when it is ready; start it if there is none."""
        self.start()
        child = self._child
        if child is None:  # closed by another thread
            raise ProcessDied("it was interrupted")
        while not child.is_ready:
            child.is_ready = any("ready" in message for message in child.read_messages())
            if not child.is_ready and time.monotonic() - child.started_at > START_TIMEOUT_S:
                raise ProcessDied(f"it did not start within {START_TIMEOUT_S:.0f} s")
        return child

    def _enforce_limits(self, job: ClipJob, child: _ChildProcess) -> None:
        """Kill the process and raise ClipLimitExceeded if the clip exceeds a limit."""
        name, limits, sentence = job.name, job.limits, ""
        if time.monotonic() - child.started_at > limits.seconds:
            sentence, option = f"{name} took more than {format_duration(limits.seconds)}", "time-limit"
        elif child.measure_memory_mb() > limits.megabytes:
            sentence, option = f"{name} took more than {limits.megabytes:.0f} MB of memory", "memory-limit"
        if sentence:
            self.end(at_once=True)
            raise ClipLimitExceeded(sentence if job.for_page else f"{sentence}; --{option} allows more")


_THREAD = threading.local()
_PROCESSES: list[SupervisedProcess] = []


def thread_process() -> SupervisedProcess:
    """Return the process of the calling thread; start it if there is none."""
    if getattr(_THREAD, "process", None) not in _PROCESSES:
        _THREAD.process = SupervisedProcess()
        _PROCESSES.append(_THREAD.process)
    process: SupervisedProcess = _THREAD.process
    return process


def end_processes() -> None:
    """End the processes of all threads; running clips are interrupted."""
    for process in _PROCESSES:
        process.request_exit()
    while _PROCESSES:
        _PROCESSES.pop().close()


# Waiting time while there is no clip to run, s.
IDLE_S = 0.5


def run_on_processes(count: int, jobs: JobStream, listener: ProgressListener) -> Iterator[ClipResult]:
    """Run clips on this machine, each in one of a few processes.

    Args:
        count: Number of processes.
        jobs: Clips to run; one is taken when a process is free.
        listener: Called with progress messages.

    Yields:
        The result of each clip, when it is done.
    """
    running: set[Future[ClipResult]] = set()
    has_more = True
    with ThreadPoolExecutor(count) as threads:
        try:
            while has_more or running:
                while has_more and len(running) < count:
                    try:
                        job = next(jobs)
                    except StopIteration:
                        has_more = False
                        break
                    if job is None:
                        break
                    running.add(threads.submit(_run_in_thread, job, listener))
                if running:
                    finished, running = wait(running, IDLE_S, FIRST_COMPLETED)
                    yield from (one.result() for one in finished)
                elif has_more:
                    time.sleep(IDLE_S)
        finally:
            end_processes()


def _run_in_thread(job: ClipJob, listener: ProgressListener) -> ClipResult:
    """Run a clip in the process of this thread."""
    return thread_process().run(job, partial(listener, job.name))
