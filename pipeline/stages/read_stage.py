"""The read stage: timestamps, size and duplicate frames of the clip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from models.core.options import option
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from video.io.clip import FPS_RANGE, Clip, open_clip


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options of reading a clip."""

    fps: str | None = option(
        None,
        help="Frame rate to use instead of the container's, in frames per second, such as 29.97 or 30000/1001.",
    )

    def __post_init__(self) -> None:
        if self.fps is None:
            return
        try:
            is_valid = FPS_RANGE[0] <= Fraction(self.fps) <= FPS_RANGE[1]
        except (ValueError, ZeroDivisionError) as error:
            raise ValueError("a number such as 29.97 or 30000/1001 was expected") from error
        if not is_valid:
            raise ValueError(f"{FPS_RANGE[0]} to {FPS_RANGE[1]} frames per second were expected")


def read_stage(path: Path, digest: str, options: ReadOptions) -> Stage:
    """Build the stage that reads a clip.

    Args:
        path: Path of the clip.
        digest: SHA-256 of the clip.
        options: Options of the stage.

    Returns:
        The stage `read`, whose output is a `CaromClip`.
    """
    return Stage("read", __name__, (), Clip, partial(_read_clip, path), options, {"clip": digest})


def _read_clip(path: Path, inputs: Inputs, options: ReadOptions, folder: Path, progress: Progress) -> Clip:
    """Read the clip."""
    fps = None if options.fps is None else Fraction(options.fps)
    clip = open_clip(path, fps=fps, progress=progress)
    return replace(clip, path=Path("clip"))  # the result depends on the content, not on the path
