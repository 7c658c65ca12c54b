"""Iteration in a background thread, ahead of the consumer.

It uses a thread instead of an executor of `models.numerics.executor`, because an iterator gives its results one by one
and cannot go to another process.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_END: Any = object()


def prefetch_items(items: Iterator[T], max_ahead: int) -> Iterator[T]:
    """Iterate in a background thread that is at most `max_ahead` results ahead of the consumer.

    This helps where the time goes into code that releases the GIL: decoding, image processing, encoding.

    Args:
        items: the iterator to run.
        max_ahead: largest number of results that wait for the consumer.

    Yields:
        The results in their order. An exception is raised where the result would have been.
    """
    pending: deque[Future[T]] = deque()
    with ThreadPoolExecutor(1, "ahead") as pool:
        try:
            pending.extend(pool.submit(next, items, _END) for _ in range(max_ahead))
            while (item := pending.popleft().result()) is not _END:
                pending.append(pool.submit(next, items, _END))
                yield item
        finally:
            for future in pending:
                future.cancel()
