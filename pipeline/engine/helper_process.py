"""A crew of two processes, for machines with two cores."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from models.numerics.executor import ALONE, Crew, Work

_AHEAD = 2
"""lots of jobs that the helper has at most: the next one lies ready when it has done one."""
_LOT = 4e-3
"""s that a lot should take: messages cost a tenth of that."""
_SWITCH = 5e-4
"""s, after which the helper's work lets it listen."""
_SUBJECT, _JOBS, _SKIP = range(3)
"""what is sent: what to work on; a lot's number, the work and its jobs; the number of a lot that was taken back."""


@contextmanager
def crew() -> Iterator[Crew]:
    """A helper where the machine has a second core, ended with the block."""
    if _cores() < 2:
        yield ALONE
        return
    try:
        pair = Pair()
    except OSError:  # no process to be had: what remains is slower
        yield ALONE
        return
    try:
        yield pair
    finally:
        pair.close()


def _cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


class Pair:
    """This process and a helper, which is asked for nothing until it has started; if it is lost, this one goes on."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(target=_help, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self.handed_over = 0
        """lots that the helper was given."""
        self._started = False
        self._subject: Any = None
        self._pace: dict[Work, float] = {}
        """s that a job of each kind took here at last."""

    @property
    def ready(self) -> bool:
        """Whether the helper has started, and was not lost."""
        if not self._started and not self._line.closed and self._line.poll():
            self._receive()
            self._started = not self._line.closed
        return self._started and not self._line.closed

    def wait(self) -> None:
        """Until the helper has started, or is lost."""
        while not (self.ready or self._line.closed):
            self._line.poll(None)

    def each(self, subject: Any, work: Work, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
        if len(jobs) < 2 or not self.ready:
            return ALONE.each(subject, work, jobs)
        if subject is not self._subject:
            self._send((_SUBJECT, subject))
            self._subject = subject
        return _Round(self, work, jobs).answers()

    def close(self) -> None:
        """End the helper, whatever it does."""
        self._line.close()
        self._process.terminate()
        self._process.join()

    def lot_of(self, work: Work) -> int:
        """How many jobs should be handed over together, to be worth a message."""
        pace = self._pace.get(work, 0.0)
        return max(int(_LOT / pace), 1) if pace else 1

    def here(self, work: Work, job: tuple[Any, ...]) -> Any:
        """What a job gives, done by this process."""
        begun = time.perf_counter()
        found = work(self._subject, *job)
        self._pace[work] = time.perf_counter() - begun
        return found

    def hand_over(self, work: Work, jobs: list[tuple[Any, ...]]) -> int:
        """Number of the lot that the helper now has."""
        self.handed_over += 1
        self._send((_JOBS, self.handed_over, work, jobs))
        return self.handed_over

    def take_back(self, lot: int) -> None:
        """The helper need not begin it any more."""
        self._send((_SKIP, lot))

    def answers(self, wait: bool) -> Iterator[tuple[int, list[Any] | None]]:
        """What the helper has done by now, or the next that it does: number of a lot and its answers, None for one that
        failed; nothing once it is lost."""
        while not self._line.closed and (wait or self._line.poll()):
            answer = self._receive()
            wait = False
            if answer is not None:
                yield answer

    @property
    def lost(self) -> bool:
        return self._line.closed

    def _send(self, message: tuple[Any, ...]) -> None:
        if not self._line.closed:
            try:
                self._line.send(message)
            except OSError:
                self.close()

    def _receive(self) -> tuple[int, list[Any] | None] | None:
        """None where nobody is there any more."""
        try:
            answer: tuple[int, list[Any] | None] = self._line.recv()
        except (OSError, EOFError):
            self.close()
            return None
        return answer


class _Round:
    """Jobs of one call: this process begins with the first, the helper with the last."""

    def __init__(self, pair: Pair, work: Work, jobs: Sequence[tuple[Any, ...]]) -> None:
        self._pair, self._work, self._jobs = pair, work, jobs
        self._left = deque(range(len(jobs)))
        """nobody has begun them."""
        self._away: dict[int, list[int]] = {}
        """the helper has these lots, by their numbers in its order."""
        self._done: dict[int, Any] = {}

    def answers(self) -> list[Any]:
        """Of all jobs, in their order."""
        try:
            while len(self._done) < len(self._jobs):
                self._share_out()
                if not self._left and len(self._away) > 1:
                    self._take_back()
                if self._left:
                    self._do(self._left.popleft())
                self._take_in(wait=not self._left and len(self._away) == 1)
        finally:
            for lot in self._away:  # of a call that has failed
                self._pair.take_back(lot)
        return [self._done[k] for k in range(len(self._jobs))]

    def _share_out(self) -> None:
        while not self._pair.lost and len(self._away) < _AHEAD:
            fair = (len(self._left) - sum(map(len, self._away.values()))) // 2
            own = [self._left.pop() for _ in range(min(self._pair.lot_of(self._work), fair))]
            if not own:
                return
            self._away[self._pair.hand_over(self._work, [self._jobs[k] for k in own])] = own

    def _take_back(self) -> None:
        """The last lot: nobody waits while the helper has more than the one that it is at."""
        lot, own = self._away.popitem()
        self._pair.take_back(lot)
        self._left.extend(own)

    def _take_in(self, wait: bool) -> None:
        for lot, answers in self._pair.answers(wait):
            own = self._away.pop(lot, [])
            if answers is None:  # done here, so that its error shows where it belongs
                for k in own:
                    self._do(k)
            else:
                self._done.update(zip(own, answers, strict=False))  # nobody waits for what was taken back
        if self._pair.lost:
            self._left.extend(k for own in self._away.values() for k in own)
            self._away.clear()

    def _do(self, k: int) -> None:
        self._done[k] = self._pair.here(self._work, self._jobs[k])


def _help(line: Connection) -> None:
    """Do what is asked until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks decides what an interrupt ends
    sys.setswitchinterval(_SWITCH)
    asked: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
    skipped: set[int] = set()
    line.send((0, None))
    threading.Thread(target=_listen, args=(line, asked, skipped), daemon=True).start()
    subject: Any = None
    while True:
        kind, *content = asked.get()
        if kind == _SUBJECT:
            (subject,) = content
            continue
        lot, work, jobs = content
        if lot in skipped:
            skipped.discard(lot)
            continue
        answers: list[Any] | None
        try:
            answers = [work(subject, *job) for job in jobs]
        except Exception:  # the other process meets the same one
            answers = None
        with suppress(OSError):
            line.send((lot, answers))


def _listen(line: Connection, asked: SimpleQueue[tuple[Any, ...]], skipped: set[int]) -> None:
    """Read all that is sent at once, so that neither side waits for the other to read."""
    while True:
        try:
            message = line.recv()
        except (OSError, EOFError):
            os._exit(0)
        if message[0] == _SKIP:
            skipped.add(message[1])
        else:
            asked.put(message)
