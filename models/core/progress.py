"""The type of progress callbacks."""

from __future__ import annotations

from collections.abc import Callable

# A function that is called with the finished share of some work, 0 to 1.
Progress = Callable[[float], None]


def ignore_progress(_: float) -> None:
    """Ignore the finished share: the callback of work that nobody follows.

    Args:
        _: Finished share, 0 to 1.
    """
