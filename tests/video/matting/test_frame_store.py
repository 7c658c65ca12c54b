"""Reused frames are cached within a memory limit, and equal those of the file in any case."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from video.io.clip import open_clip, read_frames
from video.io.video_writer import VideoWriter
from video.matting import frame_store
from video.matting.frame_store import FrameStore

LATER = frozenset({2, 5, 9})


@pytest.fixture
def read_requests(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """The frame indices of every read of the file."""
    requests: list[list[int]] = []

    def read(clip, *, indices):  # type: ignore[no-untyped-def]
        requests.append(list(indices))
        return read_frames(clip, indices=indices)

    monkeypatch.setattr(frame_store, "read_frames", read)
    return requests


def store_and_truth(tmp_path: Path) -> tuple[FrameStore, dict[int, np.ndarray]]:
    """A clip of noise whose twelve rows are its frames from the third on; and the frames by row."""
    rng = np.random.default_rng(3)
    with VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(30)) as film:
        for _ in range(14):
            film.write(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
    clip = open_clip(tmp_path / "a.mp4")
    timeline = SimpleNamespace(frame=np.arange(2, 14))
    return FrameStore(timeline, clip, LATER), {frame - 2: image for frame, image in read_frames(clip)}  # type: ignore[arg-type]


def are_equal(frames: dict[int, np.ndarray], truth: dict[int, np.ndarray]) -> bool:
    return all(np.array_equal(image, truth[row]) for row, image in frames.items())


def test_reused_rows_are_cached_while_others_are_read(tmp_path: Path, read_requests: list[list[int]]) -> None:
    rows, truth = store_and_truth(tmp_path)
    first = dict(rows.read_rows([0, 5, 11]))
    again = dict(rows.read_rows([9, 2]))
    assert list(first) == [0, 5, 11]
    assert list(again) == [2, 9]
    assert are_equal(first | again, truth)
    assert read_requests == [[2, 4, 7, 11, 13]]


def test_rows_beyond_the_memory_limit_are_read_again(
    tmp_path: Path, read_requests: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_store, "MAX_CACHE_BYTES", 2 * 64 * 48 * 3)
    rows, truth = store_and_truth(tmp_path)
    list(rows.read_rows([0]))
    assert sorted(rows.cache) == [2, 5]
    assert are_equal(dict(rows.read_rows([2, 5])), truth)
    assert len(read_requests) == 1
    assert are_equal(dict(rows.read_rows([2, 9])), truth)
    assert len(read_requests) == 2
