"""The digest that identifies the content of a clip, and the state of its files."""

from __future__ import annotations

import hashlib
import time
from functools import lru_cache
from pathlib import Path

from video.io.image_sequence import compute_sequence_digest

# ns, more than the resolution of file times (4 or 10 ms on Linux).
CLOCK_TICK_NS = 20_000_000

# Size, inode, and times of modification and change (ns) of a file, or of all files of a folder; a write changes them.
FileState = tuple[tuple[int, int, int, int], ...]


def read_file_state(path: Path) -> FileState:
    """Read the state of a file, or of all files of a folder.

    Args:
        path: the file or folder.

    Returns:
        The state; empty where it cannot be read.
    """
    try:
        facts = [one.stat() for one in (sorted(path.iterdir()) if path.is_dir() else [path])]
    except OSError:
        return ()
    return tuple((one.st_size, one.st_ino, one.st_mtime_ns, one.st_ctime_ns) for one in facts)


def compute_clip_digest(path: Path) -> str:
    """Compute the digest that identifies a clip's content.

    Args:
        path: a video file or a folder of numbered images.

    Returns:
        SHA-256 of the file's bytes in hexadecimal; for a folder, of the numbers and digests of all its images.

    Raises:
        OSError: a file cannot be read.
    """
    state = read_file_state(path)
    if not state or max(changed for *_, changed in state) > time.time_ns() - CLOCK_TICK_NS:
        return _hash_content(path)  # another write within the same tick of the clock would leave the same state
    return _hash_unchanged_content(path, state)


@lru_cache(maxsize=64)
def _hash_unchanged_content(path: Path, state: FileState) -> str:
    """Return the digest of a file or folder in this state: a command hashes it once."""
    return _hash_content(path)


def _hash_content(path: Path) -> str:
    if path.is_dir():
        return compute_sequence_digest(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
