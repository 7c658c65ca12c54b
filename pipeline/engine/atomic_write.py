"""Files and folders appear under their final name in one step, or not at all."""

from __future__ import annotations

import glob
import hashlib
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

LEFT_S = 3600.0
"""s without a write after which what lies aside on another machine's behalf was left by a process that was killed."""


@contextmanager
def aside(target: Path) -> Iterator[Path]:
    """A hidden path beside `target` to write to; it takes the target's name at the end, or is gone after an error.

    What the system says against the hidden path is said of the target: its name is the one that a user knows.
    """
    path = target.with_name(f".{target.name}{own_end()}")
    clear_left(target.parent, target.name)
    try:
        yield path
        os.replace(path, target)
    except OSError as error:
        if str(path) in (str(error.filename), str(error.filename2)):
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise
    finally:
        path.unlink(missing_ok=True)


def clear_left(folder: Path, name: str | None = None) -> None:
    """Remove what killed processes left in `folder`, of the file `name` or of all.

    A process of this machine is asked for by its number; of another machine's nothing is known but its last write.
    """
    for left in folder.glob(".*.part" if name is None else f".{glob.escape(name)}.*.part"):
        with suppress(OSError):  # another may be quicker
            if _is_dead(left.name) or time.time() - left.stat().st_mtime > LEFT_S:
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def own_end() -> str:
    """How the hidden names end of what this process has not finished."""
    return f".{machine()}-{os.getpid()}.part"


def _is_dead(name: str) -> bool:
    """Whether .NAME.MACHINE-PROCESS.part was written by a process of this machine that is gone."""
    where, _, number = name.removesuffix(".part").rpartition(".")[2].rpartition("-")
    return where == machine() and number.isdecimal() and int(number) != os.getpid() and not _runs(int(number))


def _runs(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another user's
        return True
    return True


@lru_cache(maxsize=1)
def machine() -> str:
    """Eight letters for the place where process numbers mean what they mean here: the machine since its last start, or
    the container, of which several may bear one name."""
    facts = [platform.node()]
    with suppress(OSError):  # Linux alone has these
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
        facts.append(str(Path("/proc/self/ns/pid").stat().st_ino))
    return hashlib.sha256(" ".join(facts).encode("utf-8", "replace")).hexdigest()[:8]


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A fresh folder beside `target` to fill, named as `aside` names files; at the end it takes the place of `target`,
    which is not there or is empty."""
    path = target.with_name(f".{target.name}{own_end()}")
    clear_left(target.parent, target.name)
    path.mkdir()
    try:
        yield path
        path.rename(target)
    finally:
        shutil.rmtree(path, ignore_errors=True)


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
