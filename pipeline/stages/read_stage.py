"""The read stage: timestamps, size and duplicate frames of the clip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from models.core.options import option
from models.core.progress import Progress
from pipeline.engine.process_setup import available_cores, available_memory
from pipeline.engine.stage import Inputs, Stage
from video.io.clip import FPS_RANGE, Clip, open_clip
from video.io.frame_layout import ASPECT_RANGE
from video.io.frame_memory import FrameMemory, frame_memory_budget


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options of reading a clip."""

    fps: str | None = option(
        None, help="Frame rate to use instead of the container's, in frames per second, such as 29.97 or 30000/1001."
    )

    pixel_aspect: str | None = option(
        None,
        help="Width of a pixel over its height, to use instead of what the file states, such as 64/45 or 1."
        " Positions are in square pixels.",
    )

    def __post_init__(self) -> None:
        _require_fraction(self.fps, "29.97 or 30000/1001", FPS_RANGE, "frames per second")
        _require_fraction(self.pixel_aspect, "64/45 or 1.422", ASPECT_RANGE, "times as wide as high")

    @property
    def rate(self) -> Fraction | None:
        """Frame rate, 1/s; None for the container's."""
        return None if self.fps is None else Fraction(self.fps)

    @property
    def aspect(self) -> Fraction | None:
        """Width of a pixel over its height; None for what the file states."""
        return None if self.pixel_aspect is None else Fraction(self.pixel_aspect)


def _require_fraction(text: str | None, example: str, limits: tuple[float, float], unit: str) -> None:
    """Raise ValueError unless a value is left out, or is a number within limits."""
    try:
        is_valid = text is None or limits[0] <= Fraction(text) <= limits[1]
    except (ValueError, ZeroDivisionError) as error:
        raise ValueError(f"a number such as {example} was expected") from error
    if not is_valid:
        raise ValueError(f"{limits[0]:g} to {limits[1]:g} {unit} were expected")


def open_frame_memory() -> FrameMemory:
    """Open the memory for the decoded frames of a run; leaving it as a context frees them."""
    return FrameMemory(frame_memory_budget(available_memory(), available_cores()))


def read_stage(path: Path, digest: str, options: ReadOptions, memory: FrameMemory | None = None) -> Stage:
    """Build the stage that reads a clip.

    Args:
        path: Path of the clip.
        digest: SHA-256 of the clip.
        options: Options of the stage.
        memory: Keeps the decoded frames for later stages.

    Returns:
        The stage `read`, whose output is a `Clip`.
    """
    run, adapt = partial(_read_clip, path, memory), partial(locate_clip, path, memory)
    return Stage("read", __name__, (), Clip, run, options, {"clip": digest}, adapt)


def locate_clip(path: Path, memory: FrameMemory | None, clip: Clip) -> Clip:
    """Set the path of a cached clip, which depends on the content only, and the memory for its frames."""
    return replace(clip, path=path, memory=memory)


def _read_clip(
    path: Path, memory: FrameMemory | None, inputs: Inputs, options: ReadOptions, folder: Path, progress: Progress
) -> Clip:
    """Read the clip."""
    clip = open_clip(path, fps=options.rate, aspect=options.aspect, progress=progress, memory=memory)
    return replace(clip, path=Path("clip"), memory=None)  # the result depends on the content, not on the path
