"""The process that runs clips: jobs come in on standard input, a line each; what happens goes out the same way.

    {"stage": "detect", "share": 0.4}        how far it is
    {"shot": [3, 17]}                        the third of seventeen shots of a long recording begins
    {"row": "..."}                           the clip is done

It may be killed at any moment, by a limit or by a fault of a decoder, without harm to whoever sent it. When its input
ends, its parent is gone or done with it: it stops what it does and leaves.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from pipeline.engine.process_setup import spare_collections, spare_threads

if TYPE_CHECKING:
    from models.core.progress import Progress

PAUSE_S = 0.2
"""s between two words on how far a stage is."""
LEAVE_S = 5.0
"""s for clearing up once the parent is gone."""
AT_WORK = threading.Event()
"""Set while a clip is run, and something may have to be cleared up."""


class Words:
    """A watcher that writes what it hears to the parent."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._next = 0.0

    def say(self, **word: Any) -> None:
        """One line."""
        self._out.write(json.dumps(word) + "\n")
        self._out.flush()

    def started(self, stage: str) -> Progress:
        """Who has heard of it lately hears of it again only after a while: a cached stage takes no time."""
        self._share(stage, 0.0)
        return lambda share: self._share(stage, share)

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        """The next stage says the same."""

    def shot(self, number: int, count: int) -> None:
        """A shot of a long recording begins."""
        self.say(shot=[number, count])

    def _share(self, stage: str, share: float) -> None:
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + PAUSE_S
            self.say(stage=stage, share=round(share, 3))


def main() -> NoReturn:
    """Run jobs until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the keyboard interrupts the parent, which then ends us
    signal.signal(signal.SIGTERM, _leave)
    spare_threads()
    spare_collections()
    out = _own_output()
    jobs: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(jobs,), daemon=True).start()
    from pipeline.batch.clip_job import Job
    from pipeline.batch.clip_run import run_job

    words = Words(out)
    words.say(ready=True)
    while (line := jobs.get()) is not None:
        AT_WORK.set()
        row = run_job(Job.from_text(line), words)
        AT_WORK.clear()
        words.say(row=row.as_text())
    os._exit(0)  # nothing is open; the libraries' own farewells take a second


def _own_output() -> TextIO:
    """Standard output for us alone: what a library prints there goes to standard error."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return out


def _listen(jobs: queue.SimpleQueue[str | None]) -> None:
    """Hand on lines; at their end leave by way of every clean-up, or without where that takes too long."""
    for line in sys.stdin:
        jobs.put(line)
    jobs.put(None)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(LEAVE_S)
    os._exit(1)


def _leave(number: int, frame: object) -> NoReturn:
    if not AT_WORK.is_set():
        os._exit(128 + number)  # as at the end of `main`
    sys.exit(128 + number)


def command() -> list[str]:
    """The command line that starts this process: the same Python, the same place of the project."""
    root = str(Path(__file__).resolve().parents[2])
    return [sys.executable, "-c", f"import sys; sys.path.insert(0, {root!r}); from {__name__} import main; main()"]


if __name__ == "__main__":
    main()
