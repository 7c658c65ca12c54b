"""Watches a folder for new clips."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.batch.clip_discovery import find_clips
from video.io.clip_digest import FileState, read_file_state

POLL_INTERVAL_S = 1.0
"""Time between two searches of the folder, s."""
SETTLE_S = 3.0
"""Time without a change after which a file counts as complete, s. A file that changes later is run again."""


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
            state = read_file_state(clip)
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
