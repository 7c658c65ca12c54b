"""The stages of long recordings: one finds the shots, the other reads one shot as a clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, NoOptions, Stage
from pipeline.stages.read_stage import ReadOptions, locate_clip
from video.io.clip import Clip
from video.io.frame_memory import FrameMemory


@dataclass(frozen=True, slots=True)
class ClipShot:
    """One shot of a recording."""

    whole: Clip
    """The recording."""
    number: int
    """Number of the shot, from 0."""
    first: int
    """Index of its first frame in the recording."""
    stop: int
    """Index of the frame after its last."""
    require_unchanged: Callable[[str], None]
    """Raises ClipError if the file no longer has this digest."""
    motion_s: float = 0.0
    """s in which things as small as balls move."""
    note: str = ""
    """Sentence about the part of the recording that is used."""

    @property
    def has_motion(self) -> bool:
        """Whether something as small as a ball moves."""
        return self.motion_s > 0

    @property
    def frame_count(self) -> int:
        """Number of its frames."""
        return self.stop - self.first

    @property
    def begins(self) -> float:
        """Time of its first frame in the recording, s."""
        return float(self.whole.t[self.first])

    @property
    def ends(self) -> float:
        """Time of its last frame in the recording, s."""
        return float(self.whole.t[self.stop - 1])

    @property
    def name(self) -> str:
        """Name of its folder, which its pages show too."""
        return f"shot-{self.number + 1:03d}"

    @property
    def clip(self) -> Clip:
        """Its frames as a clip."""
        part = self.whole.extract_subclip(self.first, self.stop)
        return replace(part, notes=(*part.notes, *filter(None, [self.note])))


def find_single_span(clip: Clip) -> bool:
    """Find out whether a clip is one shot by its length and its views alone, so that no frame need be searched.

    Returns:
        False where it has a cut or a fade, balls may jump, or it is long enough for several shots.
    """
    from video.calibration.shot_segmentation import LONG_RECORDING_S  # slow to import

    is_one_view = clip.views.tolist() == [[0, clip.frame_count]] and not len(clip.jumps)
    return is_one_view and float(clip.t[-1]) < LONG_RECORDING_S


def shots_stage() -> Stage:
    """Build the stage that finds the shots of a recording.

    Returns:
        The stage `shots`, whose output is `ShotIntervals`.
    """
    from video.calibration.shot_segmentation import ShotIntervals  # slow to import, and only long recordings need it

    return Stage("shots", __name__, ("read",), ShotIntervals, _find_shots, NoOptions())


def _find_shots(inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> object:
    """Find the shots of a recording."""
    from video.calibration.shot_segmentation import segment_shots

    return segment_shots(inputs["read"], progress)


def shot_stage(shot: ClipShot, digest: str, read: ReadOptions, memory: FrameMemory | None = None) -> Stage:
    """Build the stage that reads one shot, in place of the stage that reads a whole clip.

    Args:
        digest: SHA-256 of the recording.
        read: How the user wants the recording to be read.
        memory: Keeps the decoded frames for later stages.

    Returns:
        The stage `read`, whose output is a `Clip`.
    """
    stated = {"fps": read.fps, "pixel_aspect": read.pixel_aspect}
    facts = {"clip": digest, "first": shot.first, "stop": shot.stop, **stated, "note": shot.note}
    adapt = partial(locate_clip, shot.whole.path, memory)
    return Stage("read", __name__, (), Clip, lambda *_: shot.clip, NoOptions(), facts, adapt)
