"""Cache of frames of a clip that are needed more than once, within a memory limit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from models.core.typing import ImageArray
from video.io.clip import Clip, read_frames
from video.matting.ball_timeline import BallTimeline

MAX_CACHE_BYTES = 128_000_000
"""Memory for cached frames; frames beyond it are decoded again."""


@dataclass(frozen=True, slots=True)
class FrameStore:
    """The frames of a clip by their row in the timeline."""

    timeline: BallTimeline
    clip: Clip
    reused_rows: frozenset[int] = frozenset()
    """Rows that are needed again: they are cached when other rows are read."""
    cache: dict[int, ImageArray] = field(default_factory=dict)
    """Cached frames (H, W, 3) by row."""

    def read_rows(self, rows: Iterable[int]) -> Iterator[tuple[int, ImageArray]]:
        """Return (row, frame (H, W, 3)) of some rows in ascending order; the frames are read-only."""
        wanted = sorted({int(row) for row in rows})
        if self.cache.keys() >= set(wanted):
            return ((row, self.cache[row]) for row in wanted)
        return self._read_and_cache(wanted)

    def _read_and_cache(self, wanted: Sequence[int]) -> Iterator[tuple[int, ImageArray]]:
        """Decode rows in one pass, and cache reused rows on the way."""
        requested, capacity = set(wanted), MAX_CACHE_BYTES // max(3 * self.clip.width * self.clip.height, 1)
        rows = sorted(requested | self.reused_rows)
        for row, (_, image) in zip(rows, read_frames(self.clip, indices=self.timeline.frame[rows]), strict=True):
            if row in self.reused_rows and len(self.cache) < capacity:
                self.cache[row] = image
            if row in requested:
                yield row, image
