"""Pictures that are asked for again are kept while there is room, and are those of the file in any case."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from video.io.clip import open_clip, read_frames
from video.io.video_writer import VideoWriter
from video.matting import frame_store
from video.matting.frame_store import Gallery

LATER = frozenset({2, 5, 9})


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """The frames of every look into the file."""
    seen: list[list[int]] = []

    def read(clip, *, indices):  # type: ignore[no-untyped-def]
        seen.append(list(indices))
        return read_frames(clip, indices=indices)

    monkeypatch.setattr(frame_store, "read_frames", read)
    return seen


def made(tmp_path: Path) -> tuple[Gallery, dict[int, np.ndarray]]:
    """A clip of twelve pictures of noise, whose rows are its frames from the third on; and the pictures by row."""
    rng = np.random.default_rng(3)
    with VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(30)) as film:
        for _ in range(14):
            film.write(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
    clip = open_clip(tmp_path / "a.mp4")
    sightings = SimpleNamespace(frame=np.arange(2, 14))
    return Gallery(sightings, clip, LATER), {frame - 2: picture for frame, picture in read_frames(clip)}  # type: ignore[arg-type]


def same(found: dict[int, np.ndarray], truth: dict[int, np.ndarray]) -> bool:
    return all(np.array_equal(picture, truth[row]) for row, picture in found.items())


def test_what_is_asked_for_later_is_read_on_the_way(tmp_path: Path, looks: list[list[int]]) -> None:
    rows, truth = made(tmp_path)
    first = dict(rows.at([0, 5, 11]))
    again = dict(rows.at([9, 2]))
    assert list(first) == [0, 5, 11]
    assert list(again) == [2, 9]
    assert same(first | again, truth)
    assert looks == [[2, 4, 7, 11, 13]]


def test_what_does_not_fit_is_read_again(
    tmp_path: Path, looks: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_store, "MOST_BYTES", 2 * 64 * 48 * 3)
    rows, truth = made(tmp_path)
    list(rows.at([0]))
    assert sorted(rows.kept) == [2, 5]
    assert same(dict(rows.at([2, 5])), truth)
    assert len(looks) == 1
    assert same(dict(rows.at([2, 9])), truth)
    assert len(looks) == 2
