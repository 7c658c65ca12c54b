"""Watches a folder for new clips."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.batch.clip_discovery import find_clips

POLL_INTERVAL_S = 1.0
"""Time between two searches of the folder, s."""
SETTLE_S = 3.0
"""Time without a change after which a file counts as complete, s. A file that changes later is run again."""

FileState = tuple[tuple[int, int], ...]
"""Size and modification time (ns) of the file, or of all files of a folder of images."""


def watch_folder(folder: Path, excluded: Path, idle_s: float | None) -> Iterator[Path | None]:
    """Yield the clips below a folder when they are complete, and again when they have changed.

    Args:
        folder: The folder.
        excluded: A folder that is not searched.
        idle_s: Time without a new clip after which to end, s; None never ends.

    Yields:
        A clip, or None when there is none now.
    """
    observed: dict[Path, tuple[FileState, float]] = {}
    delivered: dict[Path, FileState] = {}
    last = time.monotonic()
    while idle_s is None or time.monotonic() - last < idle_s:
        began = time.monotonic()
        for clip in find_clips(folder, excluded):
            state = _read_file_state(clip)
            if delivered.get(clip) == state:
                continue
            if observed.get(clip, (None, 0.0))[0] != state:
                observed[clip] = (state, began)
                last = began
            elif began - observed[clip][1] >= SETTLE_S:
                delivered[clip] = state
                yield clip
                last = time.monotonic()
        while time.monotonic() - began < POLL_INTERVAL_S:
            yield None


def _read_file_state(clip: Path) -> FileState:
    """Read sizes and times; empty if the clip has disappeared."""
    try:
        files = sorted(clip.iterdir()) if clip.is_dir() else [clip]
        facts = [path.stat() for path in files]
    except OSError:
        return ()
    return tuple((one.st_size, one.st_mtime_ns) for one in facts)
