"""Explanation of a rally as one value: flights in space between hits, bounces and the landing.

`models.estimation.rally.explain_rally` makes a rally; `rally_views` in the same folder evaluates it at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.court_camera import CourtScene
from models.core.typing import BoolArray, FloatArray, IntArray

RallyEventKind = Literal["hit", "bounce", "net", "landing"]
# Parameters of a flight: place (3) and velocity (3) at its start, drag k, lift l (3), turn-over drag, exponent of the
# drag over speed, and share of gravity that a lagging nose carries.
FLIGHT_PARAMETERS = (
    "x", "y", "z", "vx", "vy", "vz", "drag", "lift_x", "lift_y", "lift_z", "turn_drag", "drag_exponent", "lag_lift",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class BallCandidates:
    """Where the ball or shuttle may be seen: K candidates in columns, sorted by frame; several or none in a frame."""

    frame: IntArray
    """(K,) index of the frame in presentation order, from 0."""
    centre: FloatArray
    """(K, 2) px, at mid-exposure."""
    streak: FloatArray
    """(K, 2) px, displacement during the exposure; its sign is unknown; (0, 0) where sharp."""
    score: FloatArray
    """(K,) probability that this is the object, by its look alone."""
    sigma: FloatArray
    """(K,) px, standard deviation of the centre across the streak."""
    sigma_along: FloatArray
    """(K,) px, along it."""
    players: FloatArray = field(default_factory=lambda: np.empty((0, 5)))
    """(P, 5) frame, and left, top, right and bottom, px, of the moving people."""

    def __post_init__(self) -> None:
        k = len(self.frame)
        if self.centre.shape != (k, 2) or self.streak.shape != (k, 2):
            raise ValueError(f"BallCandidates.centre and streak must be ({k}, 2)")
        for name in ("score", "sigma", "sigma_along"):
            if getattr(self, name).shape != (k,):
                raise ValueError(f"BallCandidates.{name} must be ({k},); got {getattr(self, name).shape}")
        if k and np.any(np.diff(self.frame) < 0):
            raise ValueError("BallCandidates must be sorted by frame")

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, slots=True)
class RallyEvent:
    """What happens to the object between two flights, or ends the last one."""

    kind: RallyEventKind
    t: float
    t_sigma: float
    """s."""
    place: FloatArray
    """(3,) m."""
    covariance: FloatArray
    """(3, 3) m^2."""
    probability: float
    """Of such an event at this moment."""
    speed: float
    speed_sigma: float
    """m/s: after a hit; before any other event."""
    player: str = ""
    """Of a hit: the half of the court that it comes from, `near` and `far`, or `left` and `right`."""


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight between two events."""

    start: float
    end: float
    """s; the end is that of the clip where no event ends the flight."""
    parameters: FloatArray
    """(P,) in the order of `FLIGHT_PARAMETERS`, SI units."""
    covariance: FloatArray
    """(P, P)."""
    begins_with_hit: bool
    """Whether a shuttle turns over at its start."""
    chi2: float
    """Per degree of freedom; NaN without any."""

    def __post_init__(self) -> None:
        # flights that were saved before the law had its last parameters have them at 0
        more = len(FLIGHT_PARAMETERS) - len(self.parameters)
        object.__setattr__(self, "parameters", np.pad(self.parameters, (0, more)))
        object.__setattr__(self, "covariance", np.pad(self.covariance, (0, more)))


@dataclass(frozen=True, slots=True)
class LandingHypothesis:
    """Where and when the object first touches the playing surface or floor after the last hit, if that happens so."""

    weight: float
    """Probability; those of a rally add to 1 with `Rally.no_landing`."""
    t: float
    t_sigma: float
    """s."""
    place: FloatArray
    """(3,) m."""
    covariance: FloatArray
    """(3, 3) m^2, the camera's share included."""
    is_seen: bool
    """Whether frames show the object up to there; otherwise the flight is continued by its physics."""
    is_rolling: bool = False
    """Whether it is seen to roll on the table from there on, so that nobody returns it; it touched it there, or before.
    """


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rally:
    """Explanation of the recording of one ball or shuttle over T frames."""

    scene: CourtScene
    frame: NDArray[np.int64]
    """(T,) indices of the distinct frames in the file."""
    t: FloatArray
    """(T,) s."""
    px: FloatArray
    """(T, 2) px where the object was seen; NaN where it was not."""
    px_sigma: FloatArray
    """(T, 2) px, across and along the streak."""
    streak: FloatArray
    """(T, 2) px."""
    is_used: BoolArray
    """(T,) whether the flights were fitted to this place."""
    flights: tuple[Flight, ...]
    """In the order of time; one may end before the next begins, where the object was not followed."""
    events: tuple[RallyEvent, ...]
    landings: tuple[LandingHypothesis, ...] = ()
    """The most probable first."""
    no_landing: float = 1.0
    """Probability that it does not land within the clip, nor would have before it was lost."""
    players: FloatArray = field(default_factory=lambda: np.empty((0, 5)))
    """(P, 5) as in `BallCandidates`."""
    notes: tuple[str, ...] = ()
    """Codes of irregularities."""
    last_player: tuple[str, float] = ("", 0.0)
    """Who probably hit last, and its probability: which of several hits of one player it was does not matter."""

    def __repr__(self) -> str:
        kinds = [event.kind for event in self.events]
        counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "no event"
        return f"Rally({self.scene.sport.name}, {len(self.t)} frames, {counts})"
