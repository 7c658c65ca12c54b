"""What is written aside appears whole under its name, or not at all."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import pytest

from pipeline.engine.atomic_write import LEFT_S, aside, folder_aside
from pipeline.reporting.text.sentences import one_sentence


def tear(path: Path, error: BaseException) -> None:
    """Write half of something, and fail."""
    path.write_text("half")
    raise error


def test_a_file_takes_its_name_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with aside(target) as path:
        path.write_text("new")
        assert target.read_text() == "old"
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "new")]


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), OSError(errno.EIO, "broken", "elsewhere")])
def test_after_an_error_the_old_file_stands_and_nothing_lies_beside_it(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(type(error)) as raised, aside(target) as path:
        tear(path, error)
    assert raised.value is error
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "old")]


def test_what_a_killed_process_left_long_ago_goes_and_what_another_writes_now_stays(tmp_path: Path) -> None:
    names = (".a[1].txt.77.part", ".a[1].txt.78.part", ".b.txt.77.part")
    for name, age in zip(names, (2 * LEFT_S, 0.5 * LEFT_S, 2 * LEFT_S), strict=True):
        (tmp_path / name).write_text("half")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    with aside(tmp_path / "a[1].txt") as path:
        path.write_text("whole")
    assert sorted(file.name for file in tmp_path.iterdir()) == [names[1], names[2], "a[1].txt"]


def test_a_full_disk_is_told_of_the_file_that_a_user_knows(tmp_path: Path) -> None:
    target = tmp_path / "slow.mp4"
    with pytest.raises(OSError, match="No space") as raised, aside(target) as path:
        raise OSError(errno.ENOSPC, "No space left on device", "/cache/slow.mp4", None, str(path))
    assert raised.value.errno == errno.ENOSPC
    assert one_sentence(raised.value) == (
        f"A file could not be read or written: No space left on device ({target})"
    )  # fmt: skip


def test_a_folder_takes_the_place_of_another_or_leaves_it(tmp_path: Path) -> None:
    target, within = tmp_path / "deep" / "entry", tmp_path / "building"
    within.mkdir()
    for text in ("first", "second"):
        with folder_aside(target, within, "entry-") as fresh:
            (fresh / "value").write_text(text)
        assert (target / "value").read_text() == text
    with pytest.raises(ValueError, match="torn"), folder_aside(target, within, "entry-") as fresh:
        tear(fresh / "value", ValueError("torn"))
    assert (target / "value").read_text() == "second"
    assert not list(within.iterdir())
