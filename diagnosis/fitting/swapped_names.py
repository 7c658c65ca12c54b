"""Bodies that bear each other's names from some picture on, given their own back.

A tracker may exchange two bodies. Where it does so away from a contact, both leap in one picture to where the other
one was; nothing that moves does that, and what a simulator would make of it is no gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import Recording
from models.numerics.assignment import assigned

_SIDE = 5
"""steps on either side that tell how fast a body moves."""
_FEWEST = 3
"""rows on either side that a speed can be told from."""
_FASTER = 2.0
"""times its speed on either side, from which a step is a leap: a contact changes a speed, not a place."""
_NOISE = 10.0
"""standard deviations that a step must be longer than that."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """Bodies of one shot whose names were given back, from one moment on."""

    shot: int
    t: float
    """s"""
    bodies: tuple[str, ...]

    def __str__(self) -> str:
        names = " and ".join(self.bodies)
        return f"in shot {self.shot} bodies {names} exchanged names at {self.t:.2f} s, which was taken back"


def names_given_back(recording: Recording) -> tuple[Recording, tuple[Exchange, ...]]:
    """The recording with every exchange of names taken back, and which there were; itself where there was none."""
    t, places, sigma, found = recording.t, recording.places.copy(), recording.sigma.copy(), []
    for row in range(1, len(t)):
        leapt = [body for body in range(len(recording.bodies)) if _leaps(t, places, sigma, row, body, body)]
        if not recording.seen[row, leapt].any():
            continue
        own = _own_names(t, places, sigma, row, leapt)
        if own is not None:
            places[row:, own], sigma[row:, own] = places[row:, leapt], sigma[row:, leapt]
            found.append(Exchange(recording.shot, float(t[row]), tuple(recording.bodies[body] for body in leapt)))
    return (replace(recording, places=places, sigma=sigma), tuple(found)) if found else (recording, ())


def _own_names(t: FloatArray, places: FloatArray, sigma: FloatArray, row: int, leapt: list[int]) -> list[int] | None:
    """Which body each of those that leapt is, by the shortest ways; None where one would still leap, or is itself."""
    before = np.array([places[_sides(places, row, body, body)[0][-1], body] for body in leapt])
    after = np.array([places[_sides(places, row, body, body)[1][0], body] for body in leapt])
    ways = np.linalg.norm(after[:, None] - before[None], axis=2)
    chosen = [leapt[k] for k in assigned(ways)[1]]
    for old, new in zip(leapt, chosen, strict=True):
        if old == new or _leaps(t, places, sigma, row, new, old):
            return None
    return chosen or None


def _leaps(t: FloatArray, places: FloatArray, sigma: FloatArray, row: int, before: int, after: int) -> bool:
    """Whether the step to the first place at `row` or later is longer than the speed on either side explains, of a body
    that is called `before` and then `after`."""
    first, later = _sides(places, row, before, after)
    if min(len(first), len(later)) < _FEWEST:
        return False
    one, other = places[first, before], places[later, after]
    step, time = float(np.linalg.norm(other[0] - one[-1])), float(t[later[0]] - t[first[-1]])
    fastest = max(_speed(t[first], one), _speed(t[later], other))
    return bool(step > _FASTER * fastest * time + _NOISE * float(np.median(sigma[later, after])))


def _sides(places: FloatArray, row: int, before: int, after: int) -> tuple[IntArray, IntArray]:
    """The last rows before `row`, and the first ones from there on, in which a body was seen."""
    seen: BoolArray = np.asarray(np.isfinite(places).all(axis=2))
    return np.flatnonzero(seen[:row, before])[-_SIDE - 1 :], row + np.flatnonzero(seen[row:, after])[: _SIDE + 1]


def _speed(t: FloatArray, places: FloatArray) -> float:
    """From picture to picture, as most steps say: what is hit on the way is slow for some of them."""
    return float(np.quantile(np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(t), 0.75))
