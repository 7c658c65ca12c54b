"""Stretches of shots between strikes, and the windows that a fit sees of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import Window
from models.estimation.whole_shot.free_paths import FASTEST
from models.physics.billiards.simulation.parametrised_shot import packed

SLIP = 0.7
"""of the speed, plus `AT_REST`: prior standard deviation of a slip."""
SIDE = 0.6
"""of the speed, plus `AT_REST`: prior standard deviation of R wz; a cue hit at R/2 from the middle gives 5/4."""
AT_REST = 0.1
"""m/s"""
CARRIED = 0.02
"""m/s, by which slip and side spin of a window may differ from the end of the one before."""
SLIDING = 0.3
"""of the velocity: about what the slip is expected."""
GUESSES = ((0.3, 0.4), (0.3, -0.4), (0.9, 0.4), (-0.3, -0.4))
"""slip and R wz over the speed, that a search may start from: from none of either it does not see where to go, since
what is not there cannot be spent earlier or later."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """What was seen of all N balls from `begin` on, at T times."""

    shot: int
    begin: float
    """s, <= t[0]."""
    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, N, 2) m; NaN where a ball was not seen."""
    whiten: FloatArray
    """(T, N, 2, 2): takes residuals in m to standard deviations."""
    start: FloatArray
    """(N, 7) first guess of the numbers of every ball, see `playing`."""
    moving: BoolArray
    """(N,) the balls that move at the beginning."""
    follows: bool = False
    """whether spin is carried over from the stretch before."""
    row: FloatArray | None = None
    """(T, N) of the picture, in its height from its middle; None where there is no picture."""
    late: FloatArray | None = None
    """(T,) s, by which one picture missing would shift each time; None: nothing is missing."""

    observed: tuple[IntArray, IntArray] = field(init=False, repr=False)
    """(K,) row and (K,) ball of each observation."""
    seen: FloatArray = field(init=False, repr=False)
    """(K, 2) m, what was observed."""
    whitened: FloatArray = field(init=False, repr=False)
    """(K, 2, 2) `whiten` of each observation."""

    def __post_init__(self) -> None:
        rows, balls = np.nonzero(np.isfinite(self.xy[..., 0]))
        object.__setattr__(self, "observed", (rows.astype(np.int64), balls.astype(np.int64)))
        object.__setattr__(self, "seen", self.xy[rows, balls])
        object.__setattr__(self, "whitened", self.whiten[rows, balls])

    def until(self, t: float) -> Stretch:
        """What was seen up to a time."""
        seen = self.t <= t
        row, late = (None if shift is None else shift[seen] for shift in (self.row, self.late))
        return replace(self, t=self.t[seen], xy=self.xy[seen], whiten=self.whiten[seen], row=row, late=late)


def window_of(stretch: Stretch, guesses: bool) -> Window:
    """Its observations, first guess and what is known beforehand; `guesses`: the slips are yet to be found."""
    rows, balls = stretch.observed
    start = packed(stretch.start, stretch.moving)
    speed = np.hypot(stretch.start[:, 2], stretch.start[:, 3])
    sigma = np.full(stretch.start.shape, np.inf)
    sigma[~np.isfinite(stretch.xy[..., 0]).any(axis=0), :2] = 1.0  # never seen: it stays away
    sigma[:, 2:4] = FASTEST
    sigma[:, 4:6] = (SLIP * speed + AT_REST)[:, None]
    sigma[:, 6] = SIDE * speed + AT_REST
    link = np.full(stretch.start.shape, np.inf)
    link[:, 4:] = CARRIED
    tied = packed(link, stretch.moving) if stretch.follows else None
    first = packed(_spinning(stretch.start, SLIDING, 0.0), stretch.moving) if guesses else start
    others = tuple(packed(_spinning(stretch.start, *guess), stretch.moving) for guess in GUESSES if guesses)
    known = packed(sigma, stretch.moving)
    return Window(stretch.shot, stretch.t[rows], balls, first, known, tied, () if stretch.follows else others)


def _spinning(start: FloatArray, slip: float, side: float) -> FloatArray:
    """(N, 7) with slips that are a share of the velocities, and side spins of the speeds."""
    found = start.copy()
    found[:, 4:6] = slip * start[:, 2:4]
    found[:, 6] = side * np.hypot(start[:, 2], start[:, 3])
    return found
