"""The processes of this machine that run clips: one for each thread that asks, which stays for the next clip."""

from __future__ import annotations

import threading
from contextlib import suppress

from pipeline.batch.supervision import Supervised

_HERE = threading.local()
_ALL: list[Supervised] = []
_AHEAD: list[Supervised] = []
"""Begun, and asked for by no thread yet."""


def begin(count: int) -> None:
    """Start so many ahead of the threads that will ask for them: neither need wait for the other."""
    for _ in range(count):
        process = Supervised()
        process.start()
        _ALL.append(process)
        _AHEAD.append(process)


def mine() -> Supervised:
    """The process of this thread."""
    if getattr(_HERE, "process", None) not in _ALL:
        _HERE.process = None
        with suppress(IndexError):
            _HERE.process = _AHEAD.pop()
        if _HERE.process is None:
            _HERE.process = Supervised()
            _ALL.append(_HERE.process)
    process: Supervised = _HERE.process
    return process


def end_all() -> None:
    """End the processes of all threads, together; a clip that runs is interrupted."""
    _AHEAD.clear()
    for process in _ALL:
        process.dismiss()
    while _ALL:
        _ALL.pop().close()
