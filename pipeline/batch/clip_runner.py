"""The process that runs clips: it reads jobs from standard input and writes messages to standard output, a line each.

    {"ready": true}                          the process has started
    {"stage": "detect", "share": 0.4}        progress of a stage
    {"shot": [3, 17], "done": 0.1}           the third of seventeen shots of a long recording begins, after a tenth
    {"note": "..."}                          a sentence for the user
    {"found": ["..."], "size": [1280, 720]}  first results in sentences, or a new image of them; see `first_results`
    {"row": "..."}                           the result of the clip

It may be killed at any moment, by a limit or by a fault of a decoder, without harm to its parent. When its input ends,
its parent has died or needs it no more: it stops its work and exits.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

if TYPE_CHECKING:
    from models.core.progress import Progress

# Least time between two messages about the progress of stages, s.
MESSAGE_INTERVAL_S = 0.2
# Time to remove unfinished files once the parent has died, s.
CLEANUP_S = 5.0
# Line that asks for what any clip needs, before there is a clip.
PREPARE = "prepare"
# Set while a clip runs, when there may be unfinished files.
IS_RUNNING = threading.Event()


class ProgressWriter:
    """A watcher that writes messages to the parent."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._next = 0.0

    def write_message(self, **message: Any) -> None:
        """Write one message."""
        self._out.write(json.dumps(message) + "\n")
        self._out.flush()

    def start_stage(self, stage: str) -> Progress:
        """Report a stage, unless the last message is too recent: a cached stage takes no time."""
        self._write_share(stage, 0.0)
        return lambda share: self._write_share(stage, share)

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Write nothing: the next stage reports itself."""

    def start_shot(self, number: int, count: int, done: float) -> None:
        """Report that a shot of a long recording begins, and which share of all of them is done."""
        self.write_message(shot=[number, count], done=round(done, 4))

    def write_note(self, sentence: str) -> None:
        """Report a sentence for the user."""
        self.write_message(note=sentence)

    def write_results(self, sentences: Sequence[str], size: tuple[int, int]) -> None:
        """Report first results, which are longer each time; the image of them may be new. `size` is of a frame, px."""
        self.write_message(found=list(sentences), size=size)

    def _write_share(self, stage: str, share: float) -> None:
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + MESSAGE_INTERVAL_S
            self.write_message(stage=stage, share=round(share, 3))


def main() -> NoReturn:
    """Run jobs until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the keyboard interrupts the parent, which ends this process
    signal.signal(signal.SIGTERM, _exit_on_signal)
    limit_library_threads()
    limit_garbage_collection()
    out = _reserve_output()
    jobs: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    threading.Thread(target=_queue_jobs, args=(jobs,), daemon=True).start()
    from pipeline.batch.clip_job import ClipJob
    from pipeline.batch.clip_run import prepare_run, run_job

    writer = ProgressWriter(out)
    writer.write_message(ready=True)
    while (line := jobs.get()) is not None:
        if line.strip() == PREPARE:
            prepare_run()
            continue
        IS_RUNNING.set()
        row = run_job(ClipJob.from_json(line), writer)
        IS_RUNNING.clear()
        writer.write_message(row=row.to_json())
    os._exit(0)  # nothing is open, and the exit handlers of the libraries take a second


def _reserve_output() -> TextIO:
    """Reserve standard output for messages; redirect the prints of libraries to standard error."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return out


def _queue_jobs(jobs: queue.SimpleQueue[str | None]) -> None:
    """Queue the lines of standard input; at their end exit with all clean-up, or without where that takes too long."""
    for line in sys.stdin:
        jobs.put(line)
    jobs.put(None)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLEANUP_S)
    os._exit(1)


def _exit_on_signal(number: int, frame: object) -> NoReturn:
    """Exit with all clean-up while a clip runs, else at once."""
    if not IS_RUNNING.is_set():
        os._exit(128 + number)  # as at the end of `main`
    sys.exit(128 + number)


def build_command() -> list[str]:
    """Build the command line that starts this process, with the same Python and the same copy of the project."""
    root = str(Path(__file__).resolve().parents[2])
    return [sys.executable, "-c", f"import sys; sys.path.insert(0, {root!r}); from {__name__} import main; main()"]


if __name__ == "__main__":
    main()
