"""Read: the clip's timestamps, size and repeats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from video.io.clip import RATES, Clip, open_clip


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How the clip's time is read."""

    fps: str | None = None
    """Pictures per second, such as 29.97 or 30000/1001, where the container lies about them."""

    def __post_init__(self) -> None:
        if self.fps is None:
            return
        try:
            positive = RATES[0] <= Fraction(self.fps) <= RATES[1]
        except (ValueError, ZeroDivisionError) as error:
            raise ValueError("a number such as 29.97 or 30000/1001 was expected") from error
        if not positive:
            raise ValueError(f"{RATES[0]} to {RATES[1]} pictures per second were expected")


def read_stage(path: Path, digest: str, options: ReadOptions) -> Stage:
    return Stage("read", __name__, (), Clip, partial(_run, path), options, {"clip": digest})


def _run(path: Path, inputs: Inputs, options: ReadOptions, folder: Path, progress: Progress) -> Clip:
    fps = None if options.fps is None else Fraction(options.fps)
    clip = open_clip(path, fps=fps, progress=progress)
    return replace(clip, path=Path("clip"))  # the content decides, not the name: whoever takes the clip knows its path
