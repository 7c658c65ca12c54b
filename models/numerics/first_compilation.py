"""Notification and timing of compilations: a new installation compiles all kernels, which takes a minute."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, TimingListener, install_listener

from models.numerics.jit import COMPILATION_EVENT


@contextmanager
def notify_first_compilation(notify: Callable[[], None]) -> Iterator[None]:
    """Call `notify` once, before the first compilation of a function that is cached on disk.

    Args:
        notify: Called without arguments, in the thread that compiles.

    Yields:
        None; the notification is active inside the `with` block.
    """
    with install_listener(COMPILATION_EVENT, _CompilationListener(notify)):
        yield


class _CompilationListener(Listener):  # type: ignore[misc]
    """Listens to compilations of cached functions."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify: Callable[[], None] | None = notify

    def on_start(self, event: Event) -> None:
        if self._notify is not None:
            notify, self._notify = self._notify, None
            notify()

    def on_end(self, event: Event) -> None:
        return None


@contextmanager
def measure_compilation() -> Iterator[Callable[[], float]]:
    """Measure for how long this process compiles functions that are cached on disk, or waits for them.

    Yields:
        A function that returns the time since the `with` block began, s.
    """
    with install_listener(COMPILATION_EVENT, TimingListener()) as timer:
        yield lambda: timer.duration if timer.done else 0.0
