"""A court, its net and the ball or shuttle that flies over it: what a sport fixes by its rules.

Coordinates are metres. x runs along the longer side, away from the camera or to the right of the picture, from the
corner that is nearer to the camera (of two, the left); y runs across, z up from the playing surface. Seen from behind a
baseline, (x, y, z) is therefore left-handed, and right-handed from the side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.core.typing import FloatArray

# x and y of two opposite corners, m, the smaller values first.
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Range:
    """What is known of a number before any measurement."""

    mean: float
    sigma: float


@dataclass(frozen=True, slots=True)
class CourtLine:
    """A straight painted line."""

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    """m, ends of the centre of the line."""
    width: float
    """m, of the paint."""


@dataclass(frozen=True, slots=True)
class Net:
    """A net across the middle of a court."""

    overhang: float
    """m by which its posts stand outside the court, on both sides."""
    height: float
    """m, of its upper edge at the middle."""
    post_height: float
    """m, of its upper edge at the posts."""

    def height_at(self, y: FloatArray, width: float) -> FloatArray:
        """Compute the height (...) of the upper edge, m, at places `y` (...) across a court of a width, m."""
        share = np.minimum(np.abs(y - width / 2) / (width / 2 + self.overhang), 1.0)
        return np.asarray(self.height + (self.post_height - self.height) * share**2)


@dataclass(frozen=True, slots=True)
class FlyingObject:
    """The ball or shuttle of a sport, with what is known of its forces before a clip is seen.

    The acceleration is -g z - k |v| v + |v| l x v, with drag k and a lift l across the path, as
    `models.physics.flight.flight_motion` states in full. After a hit a shuttle
    turns over: at a length s of path its drag is k (1 + `turn_drag` u^2 exp(-u) / 2) with u = 4 s / `turn_length`, and
    its lift falls as exp(-s / `turn_length`).
    """

    name: str
    """`shuttle` or `ball`; its id and kind in tables."""
    radius: float
    """m: half of what is seen of it."""
    mass: float
    """kg."""
    drag: Range
    """1/m, at 10 m/s."""
    drag_exponent: Range
    """Of the drag over the speed: 0 where the force is quadratic."""
    lift: float
    """1/m, standard deviation of each component of l about 0; 0 where there is no lift."""
    turn_drag: Range
    turn_length: float
    """m of path; 0 for a ball."""
    restitution: Range | None
    """Share of the speed across the surface that a bounce leaves; None where the object comes to rest on it."""
    retention: Range | None
    """Share of the speed along the surface that a bounce leaves."""
    max_speed: float
    """m/s that no player exceeds."""
    lag_lift: float = 0.0
    """Standard deviation, about 0, of the share of gravity that a shuttle carries because its nose lags behind a path
    that bends."""
    law_error: float = 0.003
    """m by which flights depart from this law."""
    turn_error: float = 0.0
    """m by which those of a shuttle do when it begins to turn over."""


BounceRule = Literal["none", "optional", "required"]


@dataclass(frozen=True, slots=True)
class Sport:
    """A sport over a net."""

    name: str
    """Such as `table-tennis`."""
    length: float
    width: float
    """m, to the outer edges of the lines."""
    lines: tuple[CourtLine, ...]
    net: Net
    object: FlyingObject
    areas: Mapping[str, tuple[Rectangle, ...]]
    """Where a landing is good, by the name of the rule: `singles`, `doubles`, `service-box`. Rectangles go to the
    outer edges of their lines; each lies in one half of the court.
    """
    default_area: str
    floor: float = 0.0
    """m, height of the floor; below 0 where the court is a table."""
    reach: float = 3.2
    """m above the floor up to which players hit."""
    surroundings: tuple[float, float] = (4.0, 3.0)
    """m behind the ends and beside the sides of the court in which players hit."""
    bounce: BounceRule = "none"
    """Whether the object bounces once on the half of a player before it is hit back."""
    serves_on_own_half: bool = False
    """Whether a service first touches the half of the server, and then the other."""
    is_filmed_from_side: bool = False
    """Whether the camera looks across the court, so that x runs to the right: the usual one, and in a `CourtScene` its
    own.
    """

    @property
    def halves(self) -> tuple[str, str]:
        """Names of the halves of the court, that with smaller x first."""
        return ("left", "right") if self.is_filmed_from_side else ("near", "far")

    def is_beside_table(self, z: float) -> bool:
        """Return whether an object that touches a surface at a height, m, is on the floor beside a table."""
        return bool(self.floor < 0 and z < self.floor / 2)

    @property
    def corners(self) -> FloatArray:
        """Outer corners (4, 2), m, of the court: (0, 0), (length, 0), (length, width), (0, width)."""
        return np.array([[0, 0], [self.length, 0], [self.length, self.width], [0, self.width]], np.float64)
