"""Files and folders appear under their final name in one step, or not at all."""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LEFT_S = 3600.0
"""s without a write after which what lies aside was left by a process that was killed."""


@contextmanager
def aside(target: Path) -> Iterator[Path]:
    """A hidden path beside `target` to write to; it takes the target's name at the end, or is gone after an error.

    What the system says against the hidden path is said of the target: its name is the one that a user knows.
    """
    path = target.with_name(f".{target.name}.{os.getpid()}.part")
    _clear_left(target)
    try:
        yield path
        os.replace(path, target)
    except OSError as error:
        if str(path) in (str(error.filename), str(error.filename2)):
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise
    finally:
        path.unlink(missing_ok=True)


def _clear_left(target: Path) -> None:
    """Remove what killed processes left beside `target`; their numbers say nothing where machines share a folder."""
    for left in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
        with suppress(OSError):  # another may be quicker
            if time.time() - left.stat().st_mtime > LEFT_S:
                left.unlink()


@contextmanager
def folder_aside(target: Path, within: Path, prefix: str) -> Iterator[Path]:
    """A fresh folder below `within` to fill; it takes the place of `target` at the end, or is gone after an error.

    `within` lies on the file system of `target`; the folder's name begins with `prefix`. Who fills the same target at
    the same time is kept away by the caller.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=within))
    try:
        yield folder
        if target.exists():
            shutil.rmtree(target)
        target.parent.mkdir(exist_ok=True)
        folder.rename(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
