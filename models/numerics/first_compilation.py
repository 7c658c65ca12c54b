"""When compiled loops are made: in a new installation all of them, for a minute in which nothing else happens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.caching import FunctionCache
from numba.core.event import Event, Listener, install_listener


@contextmanager
def compiling_told(tell: Callable[[], None]) -> Iterator[None]:
    """`tell` is called once, before the first function is compiled that is then kept on disk (`models.numerics.jit`)."""
    with install_listener("numba:compile", _FirstKept(tell)):
        yield


class _FirstKept(Listener):  # type: ignore[misc]
    """Not of functions that every process compiles anew: these are few and small."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, event: Event) -> None:
        if self._tell is not None and isinstance(event.data["dispatcher"]._cache, FunctionCache):
            tell, self._tell = self._tell, None
            tell()

    def on_end(self, event: Event) -> None:
        return None
