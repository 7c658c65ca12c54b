"""The processes of this machine that run clips: each thread that asks gets one, and keeps it for its next clip."""

from __future__ import annotations

import threading
from contextlib import suppress

from pipeline.batch.supervision import SupervisedProcess

_THREAD = threading.local()
_PROCESSES: list[SupervisedProcess] = []
_UNCLAIMED: list[SupervisedProcess] = []
"""Started processes that no thread has asked for yet."""


def start_processes(count: int) -> None:
    """Start processes before the threads that will ask for them.

    Args:
        count: Number of processes.
    """
    for _ in range(count):
        process = SupervisedProcess()
        process.start()
        _PROCESSES.append(process)
        _UNCLAIMED.append(process)


def thread_process() -> SupervisedProcess:
    """Return the process of the calling thread; start it if there is none."""
    if getattr(_THREAD, "process", None) not in _PROCESSES:
        _THREAD.process = None
        with suppress(IndexError):
            _THREAD.process = _UNCLAIMED.pop()
        if _THREAD.process is None:
            _THREAD.process = SupervisedProcess()
            _PROCESSES.append(_THREAD.process)
    process: SupervisedProcess = _THREAD.process
    return process


def end_processes() -> None:
    """End the processes of all threads; running clips are interrupted."""
    _UNCLAIMED.clear()
    for process in _PROCESSES:
        process.request_exit()
    while _PROCESSES:
        _PROCESSES.pop().close()
