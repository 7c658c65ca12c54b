"""Pictures of a clip that are looked at more than once: read in one go, and kept while there is room for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from models.core.typing import ImageArray
from video.io.clip import Clip, read_frames
from video.matting.ball_timeline import Sightings

MOST_BYTES = 128_000_000
"""Memory for what is kept; what does not fit is read again."""


@dataclass(frozen=True, slots=True)
class Gallery:
    """The pictures of a clip by their row in the sightings."""

    sightings: Sightings
    clip: Clip
    later: frozenset[int] = frozenset()
    """Rows that will be asked for again: they are kept when others are read."""
    kept: dict[int, ImageArray] = field(default_factory=dict)

    def at(self, rows: Iterable[int]) -> Iterator[tuple[int, ImageArray]]:
        """(row, picture (H, W, 3)) of some rows, ascending; not to be written into."""
        wanted = sorted({int(row) for row in rows})
        if self.kept.keys() >= set(wanted):
            return ((row, self.kept[row]) for row in wanted)
        return self._read(wanted)

    def _read(self, wanted: Sequence[int]) -> Iterator[tuple[int, ImageArray]]:
        asked, room = set(wanted), MOST_BYTES // max(3 * self.clip.width * self.clip.height, 1)
        rows = sorted(asked | self.later)
        for row, (_, picture) in zip(rows, read_frames(self.clip, indices=self.sightings.frame[rows]), strict=True):
            if row in self.later and len(self.kept) < room:
                self.kept[row] = picture
            if row in asked:
                yield row, picture
