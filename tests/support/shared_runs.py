"""Folders that a session fills once for all of its tests, also for those of other workers of pytest-xdist."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def fill_once(paths: pytest.TempPathFactory, name: str, fill: Callable[[Path], None]) -> Path:
    """Return a folder of the session; the first worker that asks for it fills it, the others wait for that.

    Tests must not write to it: they copy what they change.
    """
    base = paths.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, mark = shared / name, shared / f"{name}.filled"
    with FileLock(shared / f"{name}.lock"):
        if not mark.exists():
            shutil.rmtree(folder, ignore_errors=True)  # what a worker left that failed
            folder.mkdir()
            fill(folder)
            mark.touch()
    return folder
