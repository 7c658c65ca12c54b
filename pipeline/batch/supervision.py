"""Runs clips in a process of its own, and ends it where a clip takes too long or too much memory.

A decoder that hangs in foreign code, or a picture that eats all memory, can be stopped in no other way.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import psutil

from models.core.errors import TruerollError
from pipeline.batch import clip_runner
from pipeline.batch.clip_job import TRIES, Job, Limits, Row, failed, seconds_told
from pipeline.engine.atomic_write import clear_left
from pipeline.engine.result_cache import Cache

LOOK_S = 0.1
"""s between two looks at the memory of a process: at 2 GB/s it grows by 200 MB meanwhile."""
START_S = 120.0
"""s for a process to start; imports from a cold network disk take many."""
END_S = 3.0
"""s for a process to clear up when told to leave."""
RENEW_MB = 1500.0
"""MB of resident memory after a clip from which on the next one gets a fresh process."""
LAST_WORDS = 2000
"""bytes of what a process said before it died."""

Heard = Callable[[dict[str, Any]], None]
"""Hears how far a clip is: see `runner`."""


class Stopped(Exception):
    """The process was ended by us: a limit of the clip."""


class Died(Exception):
    """The process ended without having been told to."""


@dataclass(slots=True)
class _Child:
    """A process at work, and what it has said and not been heard yet."""

    process: subprocess.Popen[bytes]
    errors: IO[bytes]
    ready: bool = False
    said: bytes = b""
    peak_mb: float = 0.0
    begun: float = field(default_factory=time.monotonic)
    told: bool = False
    """Whether it was told to leave."""

    def lines(self) -> list[dict[str, Any]]:
        """What has been said since; waits for a moment. Died at its end."""
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], LOOK_S)[0]:
            return []
        part = os.read(self.process.stdout.fileno(), 1 << 16)
        if not part:
            raise Died(self.why())
        *whole, self.said = (self.said + part).split(b"\n")
        return [json.loads(line) for line in whole]

    def memory_mb(self) -> float:
        """Resident now."""
        with suppress(psutil.Error):
            now = float(psutil.Process(self.process.pid).memory_info().rss) / 1e6
            self.peak_mb = max(self.peak_mb, now)
            return now
        return 0.0

    def why(self) -> str:
        """How it ended, in words."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(END_S)
        code = self.process.returncode
        if code is not None and code < 0:
            return f"it was ended by {signal.Signals(-code).name}"
        self.errors.seek(max(self.errors.seek(0, os.SEEK_END) - LAST_WORDS, 0))
        last = self.errors.read().decode("utf-8", "replace").strip().rpartition("\n")[2]
        return f"it left with status {code}" + (f": {last}" if last else "")

    def tell(self) -> None:
        """Tell it to clear up and leave, once: a second word would break into the clearing up."""
        if not self.told:
            self.told = True
            self.process.terminate()

    def end(self, *, at_once: bool = False) -> None:
        """Let it clear up and leave, or kill it."""
        if not at_once:
            self.tell()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(END_S)
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


class Supervised:
    """A process that runs one clip after another; a context manager, which ends it."""

    def __init__(self) -> None:
        self._child: _Child | None = None
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def dismiss(self) -> None:
        """Tell it to end for good, without waiting for that: a clip that it is at is not tried again."""
        self._closed = True
        if (child := self._child) is not None:
            child.tell()

    def close(self) -> None:
        """End it for good, also from another thread: a clip that it was at is not tried again."""
        self.dismiss()
        self.end()

    def end(self, *, at_once: bool = False) -> None:
        """End the process, if there is one."""
        child, self._child = self._child, None
        if child is not None:
            child.end(at_once=at_once)

    def run(self, job: Job, heard: Heard) -> Row:
        """Run a clip; a process that dies is tried again, one that is stopped at a limit is not."""
        began, sentence = time.monotonic(), ""
        for tries in range(1, TRIES + 1):
            try:
                row = self._try(job, heard)
                return replace(row, seconds=round(time.monotonic() - began, 3), tries=tries)
            except Stopped as stop:
                sentence = str(stop)
                break
            except Died as death:
                if self._closed:
                    sentence = f"{job.name} was interrupted; run again"
                    break
                sentence = f"{job.name}: the process that ran it died {tries} times; the last time {death}"
                self.end(at_once=True)
        _clear_up(job)
        return failed(job.name, sentence, seconds=round(time.monotonic() - began, 3), tries=tries)

    def _try(self, job: Job, heard: Heard) -> Row:
        child = self._ready()
        child.begun, child.peak_mb = time.monotonic(), 0.0
        try:
            assert child.process.stdin is not None
            child.process.stdin.write(job.as_text().encode() + b"\n")
            child.process.stdin.flush()
        except OSError as error:
            raise Died(child.why()) from error
        while True:
            for word in child.lines():
                if "row" in word:
                    return self._done(child, Row.from_text(word["row"]))
                if "shot" in word:
                    child.begun = time.monotonic()
                heard(word)
            self._enforce(job.name, job.limits, child)

    def start(self) -> None:
        """Start the process if there is none, without waiting until it is ready."""
        if self._child is None:
            errors = tempfile.TemporaryFile()  # noqa: SIM115  it lives as long as the process
            process = subprocess.Popen(
                clip_runner.command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, bufsize=0
            )
            self._child = _Child(process, errors)

    def _ready(self) -> _Child:
        """The process, started if need be."""
        self.start()
        child = self._child
        if child is None:  # closed meanwhile
            raise Died("it was interrupted")
        while not child.ready:
            child.ready = any("ready" in word for word in child.lines())
            if time.monotonic() - child.begun > START_S:
                raise Died(f"it did not start within {START_S:.0f} s")
        return child

    def _done(self, child: _Child, row: Row) -> Row:
        if child.memory_mb() > RENEW_MB:
            self.end()
        return replace(row, peak_mb=round(child.peak_mb))

    def _enforce(self, name: str, limits: Limits, child: _Child) -> None:
        """Stopped where the clip is beyond a limit; its process is gone then."""
        sentence = ""
        if time.monotonic() - child.begun > limits.seconds:
            sentence = f"{name} took more than {seconds_told(limits.seconds)}; --time-limit allows more"
        elif child.memory_mb() > limits.megabytes:
            sentence = f"{name} took more than {limits.megabytes:.0f} MB of memory; --memory-limit allows more"
        if sentence:
            self.end(at_once=True)
            raise Stopped(sentence)


def _clear_up(job: Job) -> None:
    """Remove what the killed process left."""
    with suppress(OSError, TruerollError):
        clear_left(Path(job.folder))
        Cache(Path(job.cache), mark=job.mark).clear_rubbish()
