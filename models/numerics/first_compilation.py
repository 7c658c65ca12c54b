"""Notification of the first compilation of kernels: a new installation compiles all of them, which takes a minute."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.caching import FunctionCache
from numba.core.event import Event, Listener, install_listener


@contextmanager
def notify_first_compilation(notify: Callable[[], None]) -> Iterator[None]:
    """Call `notify` once, before the first compilation of a function that is cached on disk.

    Args:
        notify: Called without arguments, in the thread that compiles.

    Yields:
        None; the notification is active inside the `with` block.
    """
    with install_listener("numba:compile", _CachedCompilationListener(notify)):
        yield


class _CachedCompilationListener(Listener):  # type: ignore[misc]
    """Listens to compilations of cached functions.

    Functions that every process compiles again are ignored: they are few and small.
    """

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify: Callable[[], None] | None = notify

    def on_start(self, event: Event) -> None:
        if self._notify is not None and isinstance(event.data["dispatcher"]._cache, FunctionCache):
            notify, self._notify = self._notify, None
            notify()

    def on_end(self, event: Event) -> None:
        return None
