"""Prefetching keeps the order, respects its limit, and passes exceptions on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice

import pytest

from video.overlay.slow_motion import prefetch_items


def test_results_come_in_order_from_another_thread() -> None:
    def threads() -> Iterator[tuple[int, str]]:
        for k in range(20):
            yield k, threading.current_thread().name

    results = list(prefetch_items(threads(), 3))
    assert [k for k, _ in results] == list(range(20))
    assert all(name.startswith("ahead") for _, name in results)


def test_no_more_is_produced_than_may_wait() -> None:
    produced = []

    def counted() -> Iterator[int]:
        for k in range(100):
            produced.append(k)
            yield k

    assert list(islice(prefetch_items(counted(), 4), 3)) == [0, 1, 2]
    assert len(produced) <= 3 + 4


def test_an_error_comes_where_its_result_would() -> None:
    def failing() -> Iterator[int]:
        yield 1
        raise OSError("the disk is full")

    results = prefetch_items(failing(), 2)
    assert next(results) == 1
    with pytest.raises(OSError, match="full"):
        next(results)
