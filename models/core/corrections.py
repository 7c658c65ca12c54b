"""Corrections of a run that a person made by hand: strong priors on what the stages measure and conclude."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from models.core.rally import RallyEventKind
from models.core.scene import CUSHIONS
from models.core.tracks import KINDS
from models.core.typing import FloatArray, IntArray

# `placed`: a ball that the detector missed; `false`: what was tracked there is no ball.
BallMarkKind = Literal["placed", "false"]
# `rename` sets the id of a ball and `class` its ball class; `merge` joins two tracks of one ball; `split` cuts a track
# of two balls; `swap` exchanges two balls over a span of frames.
TrackEditKind = Literal["rename", "class", "merge", "split", "swap"]
# `mark`: there is a contact at this frame; `move`: the contact of this frame is at another one; `delete`: there is no
# contact at this frame.
ContactCorrectionKind = Literal["mark", "move", "delete"]
# What changes the velocity of the ball at a contact.
ContactCause = Literal["ball", "cushion", "strike"]

# px, larger than any frame.
LARGEST_PX = 100_000.0
# A year of video at 30 frames per second.
LARGEST_FRAME = 1e9
# Characters of the longest name of a ball.
NAME_CHARACTERS = 32
# Ball radii: largest distance of a place from the ball that it names. Beyond, another ball may be nearer.
PLACE_RADII = 2.0
# Frame intervals within which a contact is the marked one: a person points at one of the two frames around it, and the
# fit may place it one further.
TIME_FRAMES = 2.5
# Odds of a mark of a person who looked at the frames: one in a thousand is a slip. Guess.
HAND_ODDS = 1000.0
# Frame intervals: standard deviation of a time that a person chose between two frames.
HAND_TIME_FRAMES = 0.5


@dataclass(frozen=True, slots=True)
class BallPlace:
    """A ball, named by a place where it is in the image: ids change when tracks are corrected, places do not."""

    frame: int
    """Index of the frame in presentation order."""
    x_px: float
    """px, to the right, of the original frame."""
    y_px: float
    """px, down."""
    id: str = ""
    """Id of the ball when it was pointed at, for readers of the file only."""

    def __post_init__(self) -> None:
        _require_frame(self.frame)
        if not (abs(self.x_px) <= LARGEST_PX and abs(self.y_px) <= LARGEST_PX):
            raise ValueError(f"x_px and y_px are at most {LARGEST_PX:.0f} px; got {self.x_px} and {self.y_px}")

    def measure_distance(self, at: float, time: IntArray, px: FloatArray, radius_px: FloatArray) -> float:
        """Return how far a ball is from this place, in its radii.

        Args:
            at: When, in the unit of `time`; before and after the path, its ends count.
            time: (n,) frames of the path of the ball, or their indices.
            px: (n, 2) places of the ball.
            radius_px: (n,) radii of the ball.

        Returns:
            The distance.
        """
        x, y = (np.interp(at, time, px[:, axis]) for axis in (0, 1))
        return float(np.hypot(x - self.x_px, y - self.y_px)) / float(np.nanmedian(radius_px))


@dataclass(frozen=True, slots=True)
class BallMark:
    """A ball that was missed, or what is no ball."""

    kind: BallMarkKind
    ball: BallPlace
    first: int | None = None
    """First frame for which it holds; None from the start of the clip."""
    last: int | None = None
    """Last frame for which it holds; None to the end of the clip."""

    def __post_init__(self) -> None:
        _require_span(self.first, self.last)


@dataclass(frozen=True, slots=True)
class TrackEdit:
    """A change of tracks; edits apply in their order, each to the result of the ones before."""

    kind: TrackEditKind
    ball: BallPlace
    other: BallPlace | None = None
    """The second ball of `merge` and `swap`."""
    name: str = ""
    """The new id of `rename`, or the ball class of `class`."""
    first: int | None = None
    """First frame of the second ball of `split`; first frame of `swap`, None from the start of the clip."""
    last: int | None = None
    """Last frame of `swap`; None to the end of the clip."""

    def __post_init__(self) -> None:
        _require_span(self.first, self.last)
        if (self.other is None) == (self.kind in ("merge", "swap")):
            raise ValueError(f"{self.kind} needs {'a second' if self.other is None else 'only one'} ball")
        if self.kind == "split" and self.first is None:
            raise ValueError("split needs the first frame of the second ball")
        if self.kind == "class" and self.name not in KINDS:
            raise ValueError(f"class is one of {', '.join(KINDS)}; got {self.name!r}")
        if self.kind == "rename" and not is_ball_name(self.name):
            allowed = f"1 to {NAME_CHARACTERS} letters, digits, '.', '_' or '-'"
            raise ValueError(f"a name has {allowed} and is no cushion; got {self.name!r}")


@dataclass(frozen=True, slots=True)
class ContactCorrection:
    """A contact that was missed, is at another time, or did not happen."""

    kind: ContactCorrectionKind
    cause: ContactCause
    frame: float
    """Time of the contact in frames, fractional, as in events.csv."""
    ball: BallPlace
    other: BallPlace | None = None
    """The other ball, where the cause is a ball."""
    cushion: str = ""
    """The cushion, where it is a cushion."""
    to_frame: float | None = None
    """New time in frames of `move`."""

    def __post_init__(self) -> None:
        _require_times(self.kind, self.frame, self.to_frame)
        if (self.other is None) == (self.cause == "ball"):
            raise ValueError("a contact with a ball, and no other one, names the other ball")
        if (self.cushion in CUSHIONS) != (self.cause == "cushion") or (self.cushion and self.cause != "cushion"):
            raise ValueError(f"a contact with a cushion, and no other one, names one of {', '.join(CUSHIONS)}")

    @property
    def at(self) -> float:
        """Time in frames at which the contact is, or of a deleted one at which it is not."""
        return self.frame if self.to_frame is None else self.to_frame


@dataclass(frozen=True, slots=True)
class RallyCorrection:
    """An event of a rally that was missed, is at another time, or did not happen."""

    kind: ContactCorrectionKind
    event: RallyEventKind
    frame: float
    """Time of the event in frames, fractional, as in events.csv."""
    to_frame: float | None = None
    """New time in frames of `move`."""

    def __post_init__(self) -> None:
        _require_times(self.kind, self.frame, self.to_frame)

    def split_move(self) -> tuple[RallyCorrection, ...]:
        """Split a move into what it says of two moments: a deletion and a mark; other corrections stay as they are."""
        if self.to_frame is None:
            return (self,)
        return RallyCorrection("delete", self.event, self.frame), RallyCorrection("mark", self.event, self.to_frame)


@dataclass(frozen=True, slots=True)
class Corrections:
    """All corrections of a clip; None and empty where nothing was set by hand."""

    corners: tuple[tuple[float, float], ...] | None = None
    """Corners of the playing surface or of the court, px."""
    sport: str | None = None
    """Sport of a rally as in the option --sport."""
    table: str | None = None
    """Table as in the option --table."""
    ball_radius: float | None = None
    """m."""
    fps: str | None = None
    """Frame rate as in the option --fps."""
    balls: tuple[BallMark, ...] = ()
    tracks: tuple[TrackEdit, ...] = ()
    contacts: tuple[ContactCorrection, ...] = ()
    events: tuple[RallyCorrection, ...] = ()
    """Of a rally."""

    def __post_init__(self) -> None:
        corners = self.corners or ((0.0, 0.0),) * 4
        if len(corners) != 4 or not all(math.isfinite(value) for corner in corners for value in corner):
            raise ValueError("corners are four points")
        if self.ball_radius is not None and not 0 < self.ball_radius < math.inf:
            got = f"{2e3 * self.ball_radius:g} mm (ball_radius {self.ball_radius:g} m)"
            raise ValueError(f"balls have a diameter of more than 0 mm; got {got}")

    def select_span(self, first: int, stop: int) -> Corrections:
        """Return the corrections of frames `first` to `stop` - 1 of a recording."""

        def is_inside(*places: BallPlace | None) -> bool:
            return all(place is None or first <= place.frame < stop for place in places)

        return replace(
            self,
            balls=tuple(one for one in self.balls if is_inside(one.ball)),
            tracks=tuple(one for one in self.tracks if is_inside(one.ball, one.other)),
            contacts=tuple(
                one for one in self.contacts if is_inside(one.ball, one.other) and min(one.frame, one.at) >= first
            ),
            events=tuple(part for one in self.events for part in _cut_event(one, first, stop)),
        )


NO_CORRECTIONS = Corrections()


def is_ball_name(name: str) -> bool:
    """Return whether a word can be the id of a ball: it is a column of CSV files and an argument of commands."""
    allowed = name.isascii() and name.replace("-", "").replace("_", "").replace(".", "").isalnum()
    return allowed and len(name) <= NAME_CHARACTERS and name not in CUSHIONS


def _cut_event(correction: RallyCorrection, first: int, stop: int) -> tuple[RallyCorrection, ...]:
    """Cut a correction to what it says of frames `first` to `stop` - 1."""
    parts = correction.split_move()
    inside = tuple(part for part in parts if first <= part.frame < stop)
    return (correction,) if len(inside) == len(parts) else inside


def _require_frame(frame: float) -> None:
    if not 0 <= frame <= LARGEST_FRAME:
        raise ValueError(f"a frame is a number from 0 to {LARGEST_FRAME:.0f}; got {frame}")


def _require_times(kind: ContactCorrectionKind, frame: float, to_frame: float | None) -> None:
    _require_frame(frame)
    if (to_frame is None) == (kind == "move"):
        raise ValueError("move, and no other mark, has a new time to_frame")
    if to_frame is not None:
        _require_frame(to_frame)


def _require_span(first: int | None, last: int | None) -> None:
    for frame in (first, last):
        if frame is not None:
            _require_frame(frame)
    if first is not None and last is not None and last < first:
        raise ValueError(f"a span ends at its first frame or later; got {first} to {last}")
