"""Work ahead keeps order, stays near, and raises what went wrong."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice

import pytest

from video.io.prefetch import ahead


def test_results_come_in_order_from_another_thread() -> None:
    def threads() -> Iterator[tuple[int, str]]:
        for k in range(20):
            yield k, threading.current_thread().name

    found = list(ahead(threads(), 3))
    assert [k for k, _ in found] == list(range(20))
    assert all(name.startswith("ahead") for _, name in found)


def test_no_more_is_made_than_may_wait() -> None:
    made = []

    def counted() -> Iterator[int]:
        for k in range(100):
            made.append(k)
            yield k

    assert list(islice(ahead(counted(), 4), 3)) == [0, 1, 2]
    assert len(made) <= 3 + 4


def test_an_error_comes_where_its_result_would() -> None:
    def failing() -> Iterator[int]:
        yield 1
        raise OSError("the disk is full")

    results = ahead(failing(), 2)
    assert next(results) == 1
    with pytest.raises(OSError, match="full"):
        next(results)
