"""What can be chosen where the table is found and the slow motion drawn; light to import, for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Style = Literal["clean", "coach", "umpire"]


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """What the user knows about table and camera."""

    corners: str | None = None
    """The four corners of the playing surface, between the cushion noses: x,y,x,y,x,y,x,y in px, in any order."""
    table: str | None = None
    """Playing surface as LENGTHxWIDTH in metres, such as 2.54x1.27, or a preset such as pool-9ft."""
    ball_radius: float | None = None
    """Radius of the balls in metres."""


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """How the slow motion is made."""

    slow: float = 8.0
    """Times slower than the clip."""
    quick: bool = False
    """Encode fast and coarse."""
    trim_still: bool = False
    """Leave out what lies more than half a second before the first and after the last motion."""
    style: Style = "coach"
    """What is drawn: clean (nothing, while the fit is trusted), coach (trails, speeds, contacts, a plan), or umpire
    (contacts and their times; each once more at the end, close up and slower)."""

    def __post_init__(self) -> None:
        if not 1 <= self.slow <= 1000:
            raise ValueError(f"slow motion is 1 to 1000 times slower; got {self.slow:g}")
