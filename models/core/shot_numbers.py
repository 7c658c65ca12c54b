"""Numbers of a shot for players and coaches, each with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# State of the cue ball when it reaches the first ball: spinning backwards, without spin about its horizontal axis,
# turning forwards but still sliding, rolling.
SpinState = Literal["draw", "stun", "follow", "roll", "unknown"]
# All states but `unknown`, in the order of the spin.
SPIN_STATES: tuple[SpinState, ...] = ("draw", "stun", "follow", "roll")

# s between a strike and the start of a shot or of its fit as a whole, at most.
SAME_STRIKE = 0.1


@dataclass(frozen=True, slots=True)
class ShotNumber:
    """One number of a shot."""

    name: str
    """Name, such as `cue_speed`; docs/how-to/numbers-for-players.md defines all."""
    value: float
    """In `unit`; NaN where the data contain nothing about it."""
    sigma: float
    """Standard deviation of `value`, in `unit`."""
    unit: str
    """Unit symbol; empty for shares and counts."""
    observable: bool
    """Whether the data determine the number: what is not observable repeats a prior assumption."""
    ball: str = ""
    """Id of the ball that it belongs to."""
    place: str = ""
    """Pocket that it belongs to; empty where there is none."""


@dataclass(frozen=True, slots=True)
class ShotNumbers:
    """Numbers of one shot, from its strike to the next."""

    t: float
    """s, presentation time of the strike; of the first frame where the clip begins later."""
    cue: str
    """Id of the struck ball."""
    first: str
    """Id of the ball that it hits first; empty if it hits none."""
    spin_state: SpinState
    """The most probable state of the cue ball at that contact; `unknown` where it is not observable."""
    spin_state_probabilities: tuple[float, ...]
    """(4,) of `SPIN_STATES`; empty if there is no contact."""
    potted: tuple[str, ...]
    """Ids of the balls that were potted."""
    pockets: tuple[str, ...]
    """Pocket of each of them."""
    numbers: tuple[ShotNumber, ...]

    def find_number(self, name: str, ball: str = "") -> ShotNumber | None:
        """Return the number with a name, of a ball where several balls have one; None if there is none."""
        return next((one for one in self.numbers if one.name == name and ball in ("", one.ball)), None)
