"""Files and folders appear complete under their final name, or not at all."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import pytest

from pipeline.engine.atomic_write import LEFTOVER_AGE_S, replace_file, replace_folder
from pipeline.reporting.text.text_formatting import format_error


def write_half(path: Path, error: BaseException) -> None:
    """Write half of a file, and fail."""
    path.write_text("half")
    raise error


def test_a_file_takes_its_name_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with replace_file(target) as path:
        path.write_text("new")
        assert target.read_text() == "old"
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "new")]


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), OSError(errno.EIO, "broken", "elsewhere")])
def test_after_an_error_the_old_file_remains_and_no_other(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(type(error)) as raised, replace_file(target) as path:
        write_half(path, error)
    assert raised.value is error
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "old")]


def test_old_leftovers_of_killed_processes_are_removed_and_recent_files_stay(tmp_path: Path) -> None:
    names = (".a[1].txt.77.part", ".a[1].txt.78.part", ".b.txt.77.part")
    for name, age in zip(names, (2 * LEFTOVER_AGE_S, 0.5 * LEFTOVER_AGE_S, 2 * LEFTOVER_AGE_S), strict=True):
        (tmp_path / name).write_text("half")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    with replace_file(tmp_path / "a[1].txt") as path:
        path.write_text("whole")
    assert sorted(file.name for file in tmp_path.iterdir()) == [names[1], names[2], "a[1].txt"]


def test_the_error_of_a_full_disk_names_the_final_file(tmp_path: Path) -> None:
    target = tmp_path / "slow.mp4"
    with pytest.raises(OSError, match="No space") as raised, replace_file(target) as path:
        raise OSError(errno.ENOSPC, "No space left on device", "/cache/slow.mp4", None, str(path))
    assert raised.value.errno == errno.ENOSPC
    assert format_error(raised.value) == (
        f"A file could not be read or written: No space left on device ({target})"
    )  # fmt: skip


def test_a_folder_replaces_another_or_leaves_it_unchanged(tmp_path: Path) -> None:
    target, within = tmp_path / "deep" / "entry", tmp_path / "building"
    within.mkdir()
    for text in ("first", "second"):
        with replace_folder(target, within, "entry-") as fresh:
            (fresh / "value").write_text(text)
        assert (target / "value").read_text() == text
    with pytest.raises(ValueError, match="torn"), replace_folder(target, within, "entry-") as fresh:
        write_half(fresh / "value", ValueError("torn"))
    assert (target / "value").read_text() == "second"
    assert not list(within.iterdir())
