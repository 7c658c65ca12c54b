"""Atomic writing: files and folders appear under their final name in one step, or not at all."""

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

from models.core.errors import OptionError

# Age after which an unfinished file of another machine counts as left by a killed process, s since its last write.
LEFTOVER_AGE_S = 3600.0


@contextmanager
def replace_file(target: Path) -> Iterator[Path]:
    """Write a file under a hidden name and rename it at the end; after an exception nothing remains.

    Args:
        target: Final path of the file; an existing file is replaced, and its folder created if it does not exist.

    Yields:
        The hidden path beside `target` to write to.

    Raises:
        OSError: The file cannot be written. The error names `target`, the path that the user knows.
    """
    path = target.with_name(f".{target.name}{part_suffix()}")
    target.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(target.parent, target.name)
    try:
        yield path
        os.replace(path, target)
    except OSError as error:
        if str(path) in (str(error.filename), str(error.filename2)):
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise
    finally:
        path.unlink(missing_ok=True)


def parse_output_path(text: str | os.PathLike[str]) -> Path:
    """Parse the value of -o or `out`, which must not be empty: an empty path would mean the current folder.

    Returns:
        The path.

    Raises:
        OptionError: The value is empty.
    """
    if not os.fspath(text).strip():
        raise OptionError("-o, --out needs a name; an empty one was given")
    return Path(text)


def require_writable_folder(folder: Path) -> None:
    """Require that results can be written, before any work starts.

    Args:
        folder: Folder of the results; it need not exist.

    Raises:
        OptionError: It is no folder, or cannot be written.
    """
    place = folder.absolute()
    while not place.exists() and not place.is_symlink():
        place = place.parent
    if not place.is_dir():
        raise OptionError(f"The results need a folder; {place} is none, name another with -o")
    if not os.access(place, os.W_OK | os.X_OK):
        raise OptionError(f"The results need a folder that can be written; {place} cannot, name another with -o")


def write_text(target: Path, text: str) -> None:
    """Write a text, in one step.

    Args:
        target: Final path of the file; an existing file is replaced.
        text: Its content, written as UTF-8.
    """
    with replace_file(target) as path:
        path.write_text(text, encoding="utf-8")


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove unfinished files and folders of processes that were killed.

    A process of this machine is looked up by its number. For one of another machine the age of the last write decides.

    Args:
        folder: Folder that is searched, without its subfolders.
        name: Final name of the file or folder whose leftovers are removed; None for all.
    """
    for left in folder.glob(".*.part" if name is None else f".{glob.escape(name)}.*.part"):
        with suppress(OSError):  # another process may remove it first
            if _is_from_dead_process(left.name) or time.time() - left.stat().st_mtime > LEFTOVER_AGE_S:
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def part_suffix() -> str:
    """Return the suffix of hidden names that this process has not finished.

    Returns:
        `.MACHINE-PROCESS.part`
    """
    return f".{machine_id()}-{os.getpid()}.part"


def _is_from_dead_process(name: str) -> bool:
    """Whether `.NAME.MACHINE-PROCESS.part` belongs to a process of this machine that no longer runs."""
    where, _, number = name.removesuffix(".part").rpartition(".")[2].rpartition("-")
    if where != machine_id() or not number.isdecimal() or int(number) == os.getpid():
        return False
    import psutil  # few folders have leftovers

    return not psutil.pid_exists(int(number))


@lru_cache(maxsize=1)
def machine_id() -> str:
    """Return eight hexadecimal digits that identify the scope of process numbers.

    The scope is a machine since its last start, or a container; several containers may share a host name.
    """
    facts = [platform.node()]
    with suppress(OSError):  # Linux alone has these
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
        facts.append(str(Path("/proc/self/ns/pid").stat().st_ino))
    return hashlib.sha256(" ".join(facts).encode("utf-8", "replace")).hexdigest()[:8]


@contextmanager
def create_folder(target: Path) -> Iterator[Path]:
    """Fill a hidden folder and rename it to `target` at the end; after an exception nothing remains.

    Args:
        target: Final path, which must not exist or must be an empty folder; folders above it are created.

    Yields:
        The hidden folder beside `target`.
    """
    path = target.with_name(f".{target.name}{part_suffix()}")
    remove_leftovers(target.parent, target.name)
    path.mkdir(parents=True)
    try:
        yield path
        path.rename(target)
    finally:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def replace_folder(target: Path, within: Path, prefix: str) -> Iterator[Path]:
    """Fill a temporary folder and let it take the place of `target`; after an exception nothing remains.

    The caller keeps other processes from filling the same target at the same time.

    Args:
        target: Final path; an existing folder is replaced.
        within: Parent of the temporary folder, on the file system of `target`.
        prefix: Start of the temporary folder's name.

    Yields:
        The temporary folder.
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
