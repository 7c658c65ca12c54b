"""Work ahead of whoever takes its results, on another core."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_END: Any = object()


def ahead(items: Iterator[T], most: int) -> Iterator[T]:
    """What `items` gives, in order, made by a thread of its own that is at most `most` results ahead.

    It helps where the time goes into code that lets other threads run: decoding, pictures, encoding. What `items`
    raises is raised where its result would have come.
    """
    coming: deque[Future[T]] = deque()
    with ThreadPoolExecutor(1, "ahead") as pool:
        try:
            coming.extend(pool.submit(next, items, _END) for _ in range(most))
            while (item := coming.popleft().result()) is not _END:
                coming.append(pool.submit(next, items, _END))
                yield item
        finally:
            for one in coming:
                one.cancel()
