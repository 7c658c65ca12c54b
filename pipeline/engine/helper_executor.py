"""An executor with two processes: this one and a helper, for machines with two cores."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import SimpleQueue
from types import TracebackType
from typing import Any

from models.numerics.executor import SERIAL, Executor, TaskFunction
from pipeline.engine.process_setup import available_cores, limit_garbage_collection

# Batches that the helper has at most: the next one waits when the helper finishes one.
_BATCHES_AHEAD = 2
# Time that a batch should take, s. The messages of a batch take about a tenth of that (measured).
_BATCH_S = 4e-3
# Interval at which the helper's computing thread lets its listening thread run, s.
_SWITCH_INTERVAL_S = 5e-4
# Kinds of messages to the helper: (subject,), (batch number, function, arguments of its tasks), (batch number,).
_SUBJECT, _BATCH, _CANCEL = range(3)


@contextmanager
def open_executor(prepare: Callable[[], None] | None = None) -> Iterator[Executor]:
    """Start an executor that suits this machine; it ends with the `with` block.

    Args:
        prepare: Function of a module that a helper process calls before it takes tasks, e.g. for slow imports.

    Yields:
        An executor with a helper process where this process may use a second core, else the serial executor.
    """
    if available_cores() < 2:
        yield SERIAL
        return
    try:
        executor = HelperExecutor(prepare)
    except OSError:  # no process can be started: the serial executor is only slower
        yield SERIAL
        return
    try:
        yield executor
    finally:
        executor.close()


class DeferredExecutor:
    """An executor that starts a helper process only when asked to, as a context manager; before, tasks run here."""

    def __init__(self, prepare: Callable[[], None] | None = None) -> None:
        self._prepare = prepare
        self._helpers = ExitStack()
        self._executor: Executor | None = None

    def __enter__(self) -> DeferredExecutor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._helpers.close()

    def start(self) -> None:
        """Start what `open_executor` opens, unless it runs already."""
        if self._executor is None:
            self._executor = self._helpers.enter_context(open_executor(self._prepare))

    def map_tasks(self, subject: Any, function: TaskFunction, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Evaluate `function(subject, *one)` for every `one` in `arguments`; see `Executor.map_tasks`."""
        return (self._executor or SERIAL).map_tasks(subject, function, arguments)


class HelperExecutor:
    """An executor that shares tasks between this process and one helper process.

    The helper gets no tasks until it has started. If it dies, this process runs the remaining tasks.
    """

    def __init__(self, prepare: Callable[[], None] | None = None) -> None:
        context = get_context("spawn")
        self._connection, helper_end = context.Pipe()
        self._process = context.Process(target=_run_helper, args=(helper_end, prepare), daemon=True)
        self._process.start()
        helper_end.close()
        self.submitted_batches = 0
        """Number of batches that were sent to the helper."""
        self._started = False
        self._subject: Any = None
        self._task_seconds: dict[TaskFunction, float] = {}
        """Time of the latest task of each function in this process, s."""

    @property
    def is_ready(self) -> bool:
        """Whether the helper has started and is alive."""
        if not self._started and not self._connection.closed and self._connection.poll():
            self._receive_message()
            self._started = not self._connection.closed
        return self._started and not self._connection.closed

    def wait_until_ready(self) -> None:
        """Wait until the helper has started or has died."""
        while not (self.is_ready or self._connection.closed):
            self._connection.poll(None)

    def map_tasks(self, subject: Any, function: TaskFunction, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Evaluate `function(subject, *one)` for every `one` in `arguments`; see `Executor.map_tasks`."""
        if len(arguments) < 2 or not self.is_ready:
            return SERIAL.map_tasks(subject, function, arguments)
        if subject is not self._subject:
            self._send_message((_SUBJECT, subject))
            self._subject = subject
        return _TaskRound(self, function, arguments).collect_results()

    def close(self) -> None:
        """End the helper, even in the middle of a task."""
        self._connection.close()
        self._process.terminate()
        self._process.join()

    def choose_batch_size(self, function: TaskFunction) -> int:
        """Choose how many tasks to send together, so that a batch takes `_BATCH_S`."""
        seconds = self._task_seconds.get(function, 0.0)
        return max(int(_BATCH_S / seconds), 1) if seconds else 1

    def run_here(self, function: TaskFunction, arguments: tuple[Any, ...]) -> Any:
        """Run one task in this process and note how long it takes."""
        begun = time.perf_counter()
        result = function(self._subject, *arguments)
        self._task_seconds[function] = time.perf_counter() - begun
        return result

    def submit_batch(self, function: TaskFunction, arguments: list[tuple[Any, ...]]) -> int:
        """Send tasks to the helper and return the number of their batch."""
        self.submitted_batches += 1
        self._send_message((_BATCH, self.submitted_batches, function, arguments))
        return self.submitted_batches

    def cancel_batch(self, batch: int) -> None:
        """Let the helper skip a batch that it has not begun."""
        self._send_message((_CANCEL, batch))

    def receive_results(self, wait: bool) -> Iterator[tuple[int, list[Any] | None]]:
        """Yield the batches that the helper has finished; with `wait`, wait for the first of them.

        Yields:
            The number of a batch and its results, None instead of results where a task failed. Nothing if the helper
            has died.
        """
        while not self._connection.closed and (wait or self._connection.poll()):
            message = self._receive_message()
            wait = False
            if message is not None:
                yield message

    @property
    def is_lost(self) -> bool:
        """Whether the helper has died or was ended."""
        return self._connection.closed

    def _send_message(self, message: tuple[Any, ...]) -> None:
        if not self._connection.closed:
            try:
                self._connection.send(message)
            except OSError:
                self.close()

    def _receive_message(self) -> tuple[int, list[Any] | None] | None:
        """Receive the next message; None if the helper has died."""
        try:
            message: tuple[int, list[Any] | None] = self._connection.recv()
        except (OSError, EOFError):
            self.close()
            return None
        return message


class _TaskRound:
    """The tasks of one call of `map_tasks`: this process begins with the first, the helper with the last."""

    def __init__(self, executor: HelperExecutor, function: TaskFunction, arguments: Sequence[tuple[Any, ...]]) -> None:
        self._executor, self._function, self._arguments = executor, function, arguments
        self._unstarted = deque(range(len(arguments)))
        """Indices of tasks that neither process has."""
        self._submitted: dict[int, list[int]] = {}
        """Indices of the tasks that the helper has, by the number of their batch, in its order."""
        self._results: dict[int, Any] = {}

    def collect_results(self) -> list[Any]:
        """Run all tasks and return their results in order."""
        try:
            while len(self._results) < len(self._arguments):
                self._submit_fair_share()
                if not self._unstarted and len(self._submitted) > 1:
                    self._cancel_last_batch()
                if self._unstarted:
                    self._run_task(self._unstarted.popleft())
                self._store_results(wait=not self._unstarted and len(self._submitted) == 1)
        finally:
            for batch in self._submitted:  # only after a task has failed
                self._executor.cancel_batch(batch)
        return [self._results[k] for k in range(len(self._arguments))]

    def _submit_fair_share(self) -> None:
        """Send batches until the helper has `_BATCHES_AHEAD` or half of the remaining tasks."""
        while not self._executor.is_lost and len(self._submitted) < _BATCHES_AHEAD:
            fair = (len(self._unstarted) - sum(map(len, self._submitted.values()))) // 2
            size = min(self._executor.choose_batch_size(self._function), fair)
            tasks = [self._unstarted.pop() for _ in range(size)]
            if not tasks:
                return
            batch = self._executor.submit_batch(self._function, [self._arguments[k] for k in tasks])
            self._submitted[batch] = tasks

    def _cancel_last_batch(self) -> None:
        """Take the last batch back: this process runs its tasks while the helper works on the batch before it."""
        batch, tasks = self._submitted.popitem()
        self._executor.cancel_batch(batch)
        self._unstarted.extend(tasks)

    def _store_results(self, wait: bool) -> None:
        """Store the results of finished batches; reclaim the tasks of a helper that has died."""
        for batch, results in self._executor.receive_results(wait):
            tasks = self._submitted.pop(batch, [])  # empty for a batch that was taken back
            if results is None:  # run here, so that the exception is raised in this process
                for k in tasks:
                    self._run_task(k)
            else:
                self._results.update(zip(tasks, results, strict=False))
        if self._executor.is_lost:
            self._unstarted.extend(k for tasks in self._submitted.values() for k in tasks)
            self._submitted.clear()

    def _run_task(self, k: int) -> None:
        self._results[k] = self._executor.run_here(self._function, self._arguments[k])


def _run_helper(connection: Connection, prepare: Callable[[], None] | None) -> None:
    """Run batches in the helper process until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process decides what an interrupt ends
    limit_garbage_collection()
    if prepare is not None:
        prepare()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    messages: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
    cancelled: set[int] = set()
    connection.send((0, None))
    threading.Thread(target=_queue_messages, args=(connection, messages, cancelled), daemon=True).start()
    subject: Any = None
    while True:
        kind, *content = messages.get()
        if kind == _SUBJECT:
            (subject,) = content
            continue
        batch, function, arguments = content
        if batch in cancelled:
            cancelled.discard(batch)
            continue
        results: list[Any] | None
        try:
            results = [function(subject, *one) for one in arguments]
        except Exception:  # the main process runs these tasks again and raises the same exception
            results = None
        with suppress(OSError):
            connection.send((batch, results))


def _queue_messages(connection: Connection, messages: SimpleQueue[tuple[Any, ...]], cancelled: set[int]) -> None:
    """Read messages as soon as they come, so that neither process waits for the other to read."""
    while True:
        try:
            message = connection.recv()
        except (OSError, EOFError):
            os._exit(0)
        except Exception:  # a subject that cannot be rebuilt here; the main process runs all tasks itself
            os._exit(1)
        if message[0] == _CANCEL:
            cancelled.add(message[1])
        else:
            messages.put(message)
