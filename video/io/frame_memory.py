"""Decoded frames of a clip in memory, which the stages of a run share."""

from __future__ import annotations

from typing import Any

# 720 frames of 720p, or 320 of 1080p. A run takes 0.7 GB without them; a batch ends a clip that takes 4 GB.
MAX_BYTES = 1_000_000_000
# Share of the available memory per core: a batch runs a clip on every core, and most memory is for other programs.
MAX_SHARE_PER_CORE = 0.25


def frame_memory_budget(available_bytes: int, cores: int) -> int:
    """Compute the memory that the decoded frames of one process may take.

    Args:
        available_bytes: Free memory of the machine.
        cores: Cores of the machine, each of which may run a clip.

    Returns:
        Bytes.
    """
    return min(MAX_BYTES, int(MAX_SHARE_PER_CORE * available_bytes / cores))


class FrameMemory:
    """The decoded frames of one clip, as long as all of them fit.

    Frames stay in the pixel format of the decoder, mostly 1.5 bytes a pixel instead of the 3 of RGB. Where the clip
    does not fit, no frame stays, and every pass decodes the clip again: a video is decoded from its start, so a part of
    it in memory would save nothing. Only one thread may read at a time.
    """

    def __init__(self, budget: int = 0) -> None:
        self.budget = budget
        """Bytes that the frames may take."""
        self._bytes = 0
        self.frames: list[Any] = []
        """Frames of the clip from the first one on, as decoded."""
        self.is_complete = False
        """Whether these are all frames of the clip."""
        self.is_exceeded = False
        """Whether the clip does not fit."""
        self.is_closed = False
        """Whether the run has ended."""

    def __reduce__(self) -> tuple[type[FrameMemory], tuple[()]]:
        """Send no frames to another process: that takes longer than to decode them there."""
        return FrameMemory, ()

    def __enter__(self) -> FrameMemory:
        return self

    def __exit__(self, *exception: object) -> None:
        self._clear()
        self.is_closed = True

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: empty unless the clip does not fit."""
        size = f"{self.budget / 1e6:.0f} MB of memory"
        return (f"its frames take more than {size}, so each stage decodes them again",) if self.is_exceeded else ()

    @property
    def is_filling(self) -> bool:
        """Whether the next decoded frame will be kept."""
        return self.budget > 0 and not (self.is_complete or self.is_exceeded or self.is_closed)

    def add_frame(self, index: int, frame: Any) -> None:
        """Keep a frame if it is the first or follows the last one; where it does not fit, drop all."""
        if index != len(self.frames) or not self.is_filling:
            return
        self.frames.append(frame)
        self._bytes += sum(plane.buffer_size for plane in frame.planes)
        if self._bytes > self.budget:
            self.is_exceeded = True
            self._clear()

    def extract_frames(self, first: int, stop: int) -> FrameMemory:
        """Return the memory of a part of the clip, with frames [first, stop) where all frames are held."""
        part = FrameMemory(self.budget)
        if self.is_complete:
            part.frames, part.is_complete = self.frames[first:stop], True
        return part

    def _clear(self) -> None:
        self.frames.clear()
        self._bytes, self.is_complete = 0, False
