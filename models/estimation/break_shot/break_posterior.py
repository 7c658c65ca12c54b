"""What plays of a burst have in common: its contacts, each with its probability, and the balls as they leave it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.break_shot.break_data import Burst
from models.estimation.break_shot.break_search import Plays
from models.estimation.break_shot.break_simulation import Play
from models.physics.billiards.simulation.event_engine import BALL, FIRST, KIND, SECOND, SPEED, TIME
from models.physics.billiards.simulation.parametrised_shot import slips
from models.physics.billiards.simulation.simulated_shot import STATE, Run

LULL = 6.0
"""ball radii that the coming ball would go on, without a contact of any: then the burst is over."""
LEAST_SPEED = 0.02
"""m/s of closing; slower contacts change nothing."""
LIKELY = 0.5
"""A contact is told that happens in so many of the plays, weighted."""
MOST_SURE = 0.96
"""Of contacts that all plays share, so many were true on breaks of a world with other code (`benchmarks/breaks.py`)."""
LEAST_SIGMA = 1e-4
"""s: balls that touch for a third of a millisecond do not touch at a moment."""
PLACE_SIGMA, SPEED_SIGMA, SLIP_SIGMA = 1e-4, 0.01, 0.03
"""m, and of the speed of a ball: what the laws of contacts miss."""
AFTER = 1e-9
"""s after a contact, when the balls have left each other."""


@dataclass(frozen=True, slots=True)
class Touch:
    """A contact of two balls in a burst."""

    t: float
    t_sigma: float
    """s of the clip."""
    a: int
    b: int
    """The faster ball, and the other: their numbers in the tracks."""
    xy: FloatArray
    """(2,) m, where ball a is."""
    speed: float
    """m/s of closing."""
    probability: float


@dataclass(frozen=True, slots=True)
class Leaving:
    """A ball in a burst, from its first contact to its last one."""

    ball: int
    """Its number in the tracks."""
    since: float
    until: float
    """s of the clip."""
    state: FloatArray
    """(6,) place, velocity and slip as it leaves, m and m/s."""
    covariance: FloatArray
    """(6, 6) of the state."""
    came: FloatArray
    """(2,) m, where it is at its first contact, and `came_covariance` (2, 2) of that."""
    came_covariance: FloatArray


@dataclass(frozen=True, slots=True)
class ToldBurst:
    """A burst as its best play has it, with what the others say of that."""

    plays: Plays
    touches: tuple[Touch, ...]
    leaving: tuple[Leaving, ...]


def told(plays: Plays) -> ToldBurst:
    """The contacts from the first to the last before a lull, and how the balls leave."""
    burst, best = plays.burst, plays.played[0].run
    contacts = _contacts(best)
    last = _until(burst, contacts)
    contacts = contacts[contacts[:, TIME] <= last]
    others = [_contacts(one.run) for one in plays.played]
    directions = Play(burst, burst.ends).directions(plays.played[0].numbers)
    touches = [_touch(plays, directions, others, contacts, k) for k in range(len(contacts))]
    leaving = []
    for number in range(len(burst.balls)):
        mine = contacts[(contacts[:, FIRST] == number) | (contacts[:, SECOND] == number), TIME]
        if len(mine):
            leaving.append(_leaving(plays, directions, number, float(mine[0]), float(mine[-1])))
    return ToldBurst(plays, tuple(touch for touch in touches if touch.probability > LIKELY), tuple(leaving))


def _contacts(run: Run) -> FloatArray:
    """Rows of the engine's contacts of two balls that come together fast enough."""
    events = run.contacts
    return np.asarray(events[(events[:, KIND] == BALL) & (events[:, SPEED] > LEAST_SPEED)])


def _until(burst: Burst, contacts: FloatArray) -> float:
    """s of the run, when the last contact before a lull happens; a picture or more shows what it left."""
    lull = max(burst.interval, LULL * burst.table.ball_radius / burst.speed)
    latest = burst.ends - burst.begins - 1.5 * burst.interval
    times = contacts[contacts[:, TIME] <= latest, TIME]
    if not len(times):
        return 0.0
    pause = np.flatnonzero(np.diff(times) > lull)
    return float(times[pause[0]] if len(pause) else times[-1])


def _touch(plays: Plays, directions: FloatArray, others: list[FloatArray], contacts: FloatArray, k: int) -> Touch:
    """Contact k of the best play; the other plays have it where the same balls meet as often, about then."""
    burst, best = plays.burst, plays.played[0].run
    row = contacts[k]
    a, b, t = int(row[FIRST]), int(row[SECOND]), float(row[TIME])
    mine = np.flatnonzero(_same(contacts, a, b))
    again = int(np.searchsorted(mine, k))
    moments = np.full(len(others), np.nan)
    for m, other in enumerate(others):
        theirs = other[_same(other, a, b), TIME]
        if again < len(theirs) and abs(theirs[again] - t) < burst.interval:
            moments[m] = theirs[again]
    has = np.isfinite(moments)
    share = plays.weight[has] / plays.weight[has].sum()
    spread = float(np.hypot(np.sqrt(share @ (moments[has] - t) ** 2), _moment_sigma(plays, directions, a, b, t)))
    return Touch(
        burst.begins + t, max(spread, LEAST_SIGMA), burst.balls[a], burst.balls[b], best.at(t)[a, :2],
        float(row[SPEED]), MOST_SURE * float(plays.weight[has].sum()),
    )  # fmt: skip


def _same(contacts: FloatArray, a: int, b: int) -> NDArray[np.bool_]:
    one, two = contacts[:, FIRST], contacts[:, SECOND]
    return np.asarray(((one == a) & (two == b)) | ((one == b) & (two == a)))


def _leaving(plays: Plays, directions: FloatArray, number: int, first: float, last: float) -> Leaving:
    burst = plays.burst
    came, came_covariance = _there(plays, directions, number, first - AFTER)
    state, covariance = _there(plays, directions, number, last + AFTER)
    return Leaving(
        burst.balls[number], burst.begins + first, burst.begins + last, state, covariance,
        came[:2], came_covariance[:2, :2],
    )  # fmt: skip


def _there(plays: Plays, directions: FloatArray, number: int, t: float) -> tuple[FloatArray, FloatArray]:
    """Place, velocity and slip (6,) of a ball at t, s of the run, as the best play has it, and their covariance (6, 6):
    the errors of its numbers, what other plays have, and what the laws of two balls miss of real ones."""
    there = np.array([slips(one.run.at(t), one.run.balls.radius)[number, :6] for one in plays.played])
    (slope,), other = _slopes(plays, directions, (number,), t), there - there[0]
    speed = float(np.hypot(*there[0, 2:4]))
    floor = np.repeat([PLACE_SIGMA, SPEED_SIGMA * speed + LEAST_SPEED, SLIP_SIGMA * speed + LEAST_SPEED], 2)
    return there[0], slope @ plays.covariance @ slope.T + (other.T * plays.weight) @ other + np.diag(floor**2)


def _slopes(plays: Plays, directions: FloatArray, numbers: tuple[int, ...], t: float) -> FloatArray:
    """Derivatives (K, 6, P) of place, velocity and slip of K balls at t, s of the run, by the numbers of the best play;
    `directions` are those of `Play.directions`."""
    run, chosen = plays.played[0].run, list(numbers)
    place = np.full((1, len(plays.burst.balls)), -1)
    place[0, chosen] = np.arange(len(chosen))
    slopes = run.along(np.array([t]), place, directions, STATE)
    return slips(slopes.transpose(2, 0, 1), run.balls.radius[chosen]).transpose(1, 2, 0)[:, :6]


def _moment_sigma(plays: Plays, directions: FloatArray, a: int, b: int, t: float) -> float:
    """s, how far the errors of its numbers move a contact of the best play: by what they change of the gap between two
    balls, at the speed at which it closes."""
    before = t - AFTER
    states = slips(plays.played[0].run.at(before), plays.played[0].run.balls.radius)
    apart = states[b, :2] - states[a, :2]
    line = apart / np.hypot(*apart)
    closing = max(float((states[a, 2:4] - states[b, 2:4]) @ line), LEAST_SPEED)
    one, two = _slopes(plays, directions, (a, b), before)
    gap = line @ (two[:2] - one[:2])
    return float(np.hypot(np.sqrt(max(gap @ plays.covariance @ gap, 0.0)), PLACE_SIGMA)) / closing
