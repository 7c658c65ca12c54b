"""A crew of two processes, for machines with two cores."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from models.shooting.crew import ALONE, Crew, Work

_AHEAD = 2
"""jobs that the helper has at most: the next one lies ready when it has done one."""


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


@dataclass(slots=True)
class _Round:
    """Jobs of one call: who has which, and what came of them."""

    subject: Any
    work: Work
    jobs: Sequence[tuple[Any, ...]]
    left: deque[int] = field(init=False)
    """nobody has begun them."""
    away: deque[int] = field(default_factory=deque)
    """the helper has them, in their order."""
    done: dict[int, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.left = deque(range(len(self.jobs)))

    def do(self, k: int) -> None:
        """Here."""
        self.done[k] = self.work(self.subject, *self.jobs[k])

    def return_all(self) -> None:
        """Nobody has what was away."""
        self.left.extendleft(reversed(self.away))
        self.away.clear()


class Pair:
    """This process and a helper, which is asked for nothing until it has started; if it is lost, this one goes on."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(target=_help, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self.handed_over = 0
        """jobs that the helper was given."""
        self._started = False
        self._subject: Any = None

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
        round_ = _Round(subject, work, jobs)
        if subject is not self._subject:
            self._send(round_, ("subject", subject))
            self._subject = subject
        try:
            self._share_out(round_)
        finally:
            while round_.away and self._receive() is not None:  # or it would be taken for answers to the next call
                round_.away.popleft()
        return [round_.done[k] for k in range(len(jobs))]

    def close(self) -> None:
        """End the helper, whatever it does."""
        self._line.close()
        self._process.terminate()
        self._process.join()

    def _share_out(self, round_: _Round) -> None:
        while round_.left or round_.away:
            while not self._line.closed and len(round_.away) < min(_AHEAD, len(round_.left)):
                self._hand_out(round_)
            if round_.left:
                round_.do(round_.left.popleft())
            while round_.away and (not round_.left or self._line.poll()):
                self._take_in(round_)

    def _hand_out(self, round_: _Round) -> None:
        k = round_.left.pop()
        round_.away.append(k)
        self.handed_over += 1
        self._send(round_, (round_.work, round_.jobs[k]))

    def _send(self, round_: _Round, message: tuple[Any, ...]) -> None:
        try:
            self._line.send(message)
        except OSError:
            self._lost(round_)

    def _take_in(self, round_: _Round) -> None:
        """The helper's next result; what it could not do is done here, so that its error shows where it belongs."""
        answer = self._receive()
        if answer is None:
            self._lost(round_)
            return
        k, (well, result) = round_.away.popleft(), answer
        if well:
            round_.done[k] = result
        else:
            round_.do(k)

    def _receive(self) -> tuple[bool, Any] | None:
        """None where nobody is there any more."""
        try:
            answer: tuple[bool, Any] = self._line.recv()
        except (OSError, EOFError):
            self._line.close()
            return None
        return answer

    def _lost(self, round_: _Round) -> None:
        round_.return_all()
        self.close()


def _help(line: Connection) -> None:
    """Do what is asked until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks decides what an interrupt ends
    asked: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
    line.send((True, None))
    threading.Thread(target=_listen, args=(line, asked), daemon=True).start()
    subject = None
    while True:
        work, content = asked.get()
        if work == "subject":
            subject = content
            continue
        try:
            answer = True, work(subject, *content)
        except Exception as error:  # the other process meets the same one
            answer = False, repr(error)
        with suppress(OSError):
            line.send(answer)


def _listen(line: Connection, asked: SimpleQueue[tuple[Any, ...]]) -> None:
    """Read all that is sent at once, so that neither side waits for the other to read."""
    while True:
        try:
            asked.put(line.recv())
        except (OSError, EOFError):
            os._exit(0)
