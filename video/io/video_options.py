"""Options of camera calibration and of the slow-motion video; fast to import, for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from models.core.options import option
from models.sports.sport_catalogue import find_sports

OverlayStyle = Literal["clean", "coach", "umpire"]
# The sport of clips without a court.
BILLIARDS = "billiards"


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """Options of table localisation and camera calibration."""

    corners: str | None = option(
        None, help="Corners of the playing surface, between the cushion noses, in any order: x,y,x,y,x,y,x,y in px."
    )
    table: str | None = option(
        None, help="Playing surface as LENGTHxWIDTH in m, such as 2.54x1.27, or a preset such as pool-9ft."
    )
    ball_radius: float | None = option(None, help="Radius of the balls.", unit="m")
    profile: str = option(
        "", help="Table profile (FILE): the calibration starts from its corners, table and ball size."
    )


@dataclass(frozen=True, slots=True)
class CourtOptions:
    """Options of finding a court and its camera."""

    sport: str | None = option(
        None,
        help=f"{BILLIARDS}, {', '.join(find_sports())}. Default: billiards where the clip shows such a table, else the"
        " sport of its court.",
    )
    corners: str | None = option(None, help="With --sport, of a court: its outer corners.")

    def __post_init__(self) -> None:
        names = (BILLIARDS, *find_sports())
        if self.sport is not None and self.sport not in names:
            raise ValueError(f"{', '.join(names[:-1])} or {names[-1]} was expected")

    @property
    def has_court(self) -> bool:
        """Whether the user said that the clip shows a court."""
        return self.sport not in (None, BILLIARDS)


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Options of the slow-motion video."""

    slow: float = option(8.0, help="Slow-down factor relative to the clip.", unit="times", minimum=1, maximum=100)
    quick: bool = option(
        False, help="Encode the slow motion faster, at lower quality; it is still made, last. --no-video leaves it out."
    )
    no_video: bool = option(False, help="Leave out the slow motion, which takes most of the time.")
    trim_still: bool = option(
        False, help="Leave out everything more than half a second before the first and after the last motion."
    )
    style: OverlayStyle = option(
        "coach",
        help="Overlay: clean (nothing, while the fit is trusted), coach (trails, speeds, contacts, a plan), or umpire"
        " (contacts and their times; each again at the end, in a slower close-up).",
    )

    def __post_init__(self) -> None:
        if not 1 <= self.slow <= 1000:
            raise ValueError(f"slow motion is 1 to 1000 times slower; got {self.slow:g}")
