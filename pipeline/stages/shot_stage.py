"""Shots: where in a long recording there is one; and one of them as a clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from video.io.clip import Clip


@dataclass(frozen=True, slots=True)
class Shot:
    """One shot of a recording."""

    whole: Clip
    """The recording."""
    number: int
    """From 0."""
    first: int
    """Its first picture in the recording."""
    stop: int
    """The picture before which it ends."""
    unchanged: Callable[[str], None]
    """Raises where the file is no longer the one of this digest."""

    @property
    def name(self) -> str:
        """As its folder and its pages are called."""
        return f"shot-{self.number + 1:03d}"

    @property
    def clip(self) -> Clip:
        """Its pictures, counted and timed from its first."""
        return self.whole.between(self.first, self.stop)


@dataclass(frozen=True, slots=True)
class NoOptions:
    """There is nothing to choose."""


def shots_stage() -> Stage:
    from video.calibration.shot_cuts import Shots  # slow to import, and only long recordings need it

    return Stage("shots", __name__, ("read",), Shots, _find, NoOptions())


def _find(inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> object:
    from video.calibration.shot_cuts import find_shots

    return find_shots(inputs["read"], progress)


def shot_stage(shot: Shot, digest: str, fps: str | None) -> Stage:
    """The pictures of one shot, in place of those of the whole clip."""
    facts = {"clip": digest, "first": shot.first, "stop": shot.stop, "fps": fps}
    return Stage("read", __name__, (), Clip, partial(_cut, shot), NoOptions(), facts)


def _cut(shot: Shot, inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> Clip:
    return shot.clip
