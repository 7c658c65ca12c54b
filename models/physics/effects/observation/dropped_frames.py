"""Dropped frames: pictures are missing, and the times do not tell.

From one picture of a shot on, everything has moved on by so many pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class DroppedFrames:
    """A common jump in time, once in a shot that shows one."""

    name: str = "dropped_frames"
    kind: EffectKind = "observation"
    phases: tuple[Phase, ...] = ("time_jump",)
    parameters: tuple[Prior, ...] = (Prior("frames", "1", 0.0, 2.0, False, (-20.0, 20.0)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ()
    reference: str = "Screen recorders and phones under load drop single pictures"
