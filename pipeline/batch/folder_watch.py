"""A folder that fills: clips as they come to rest."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.batch.clip_discovery import find_clips

LOOK_S = 1.0
"""s between two looks."""
REST_S = 3.0
"""s without a change after which a file is taken for whole; one that changes later is run again."""

State = tuple[tuple[int, int], ...]
"""Sizes and times of the file, or of the files of a folder of pictures."""


def arriving(folder: Path, besides: Path, idle_s: float | None) -> Iterator[Path | None]:
    """Clips below `folder` once they are at rest, and again where they have changed; None where there is none now.

    Ends after `idle_s` in which none came, never without it.
    """
    seen: dict[Path, tuple[State, float]] = {}
    done: dict[Path, State] = {}
    last = time.monotonic()
    while idle_s is None or time.monotonic() - last < idle_s:
        began = time.monotonic()
        for clip in find_clips(folder, besides):
            state = _state(clip)
            if done.get(clip) == state:
                continue
            if seen.get(clip, (None, 0.0))[0] != state:
                seen[clip] = (state, began)
                last = began
            elif began - seen[clip][1] >= REST_S:
                done[clip] = state
                yield clip
                last = time.monotonic()
        while time.monotonic() - began < LOOK_S:
            yield None


def _state(clip: Path) -> State:
    try:
        files = sorted(clip.iterdir()) if clip.is_dir() else [clip]
        facts = [path.stat() for path in files]
    except OSError:
        return ()
    return tuple((one.st_size, one.st_mtime_ns) for one in facts)
