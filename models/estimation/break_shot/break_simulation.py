"""A burst played from numbers: how far it misses what was seen and known, and the derivatives of that.

Sought are the state of the coming ball, the place of every other one, friction and restitution, and the distance at
which balls touch. Half a millimetre by which balls of a rack lie off their places decides who meets whom, and no camera
sees it; but where the balls go tells it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, IntArray
from models.estimation.break_shot.break_data import Burst
from models.estimation.multiple_shooting.normal_equations import huber
from models.physics.billiards.simulation.parametrised_shot import (
    ABSENT,
    FACTOR,
    LYING,
    MOVING,
    NUMBERS,
    Laws,
    balls_of,
    directions_of,
    played,
)
from models.physics.billiards.simulation.simulated_shot import Run
from models.physics.effects.catalogue import prior_of

LAWS = Laws("mathavan_2010", "alciatore")
"""Cushions hardly matter: a ball is followed until it meets one."""
SOUGHT = (NUMBERS.index("sliding_friction.mu"), NUMBERS.index("ball_restitution.e"), FACTOR)
"""Numbers that all balls share; what else the cloth does is of no account within a tenth of a second."""
FACTOR_SIGMA = 0.005
"""of the distance of touching balls, beside what the whole clip tells of it."""
NEIGHBOURS = 4e-3
"""m between the surfaces of two balls that were set to touch, as far as a camera tells."""
GAP_SIGMA = 6e-4
"""m, of what is left between balls that were set to touch."""
OVERLAP_SIGMA = 2e-5
"""m: balls do not lie in each other."""
SLIP_SIGMA, SIDE_SIGMA = 0.5, 0.35
"""of the speed of the coming ball."""
_PUSHES = 60
"""rounds in which balls that overlap move apart."""


@dataclass(frozen=True)
class Play:
    """The numbers (P,) of a burst: 7 of the coming ball, 2 of each other one, and those `SOUGHT`."""

    burst: Burst
    until: float
    """s: what is seen later is not looked at yet."""

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(N + 1,)"""
        return np.asarray(np.arange(len(self.burst.balls)) == 0)

    @cached_property
    def shared(self) -> int:
        """Where the numbers begin that all balls share."""
        return MOVING + LYING * (len(self.burst.balls) - 1)

    @cached_property
    def rows(self) -> IntArray:
        """Samples that are looked at."""
        return np.flatnonzero(self.burst.t <= self.until)

    @cached_property
    def neighbours(self) -> tuple[IntArray, IntArray]:
        """Pairs of balls, among those that lie, that were set to touch."""
        places = self.burst.lying
        apart = np.linalg.norm(places[:, None] - places, axis=2) - 2 * self.burst.table.ball_radius
        one, two = np.nonzero(np.triu(apart < NEIGHBOURS, 1))
        return one, two

    @cached_property
    def usual(self) -> tuple[FloatArray, FloatArray]:
        """The numbers (P,) as they are expected, and their standard deviations; infinite where nothing is known."""
        burst, size = self.burst, self.shared + len(SOUGHT)
        value, sigma = np.empty(size), np.full(size, np.inf)
        value[:MOVING], sigma[:MOVING] = burst.coming, burst.coming_sigma
        sigma[4:6] = np.minimum(sigma[4:6], SLIP_SIGMA * burst.speed)
        sigma[6] = min(float(sigma[6]), SIDE_SIGMA * burst.speed)
        value[MOVING : self.shared] = burst.lying.ravel()
        sigma[MOVING : self.shared] = np.repeat(burst.lying_sigma, LYING)
        sliding, restitution = prior_of("sliding_friction", "mu"), prior_of("ball_restitution", "e")
        value[self.shared :] = [burst.friction[0], restitution.value, burst.diameter]
        sigma[self.shared :] = [sliding.sigma * sliding.value, restitution.sigma, FACTOR_SIGMA]
        return value, sigma

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """What the shared numbers do not exceed."""
        sliding, restitution = prior_of("sliding_friction", "mu"), prior_of("ball_restitution", "e")
        low, high = zip(sliding.bounds, restitution.bounds, (0.95, 1.05), strict=True)
        return np.array(low), np.array(high)

    def values(self, numbers: FloatArray) -> FloatArray:
        """(Q,) all numbers of `playing.NUMBERS`."""
        found = ABSENT.copy()
        for effect, parameter in (("spin_decay", "rate"), ("cushion_restitution", "e"), ("cushion_friction", "mu")):
            found[NUMBERS.index(f"{effect}.{parameter}")] = prior_of(effect, parameter).value
        found[NUMBERS.index("rolling_resistance.mu")] = self.burst.friction[1]
        found[list(SOUGHT)] = numbers[self.shared :]
        return found

    def run(self, numbers: FloatArray) -> Run:
        """The shot from `burst.begins` on; ArithmeticError where balls meet without end."""
        seconds = min(self.until, self.burst.ends) - self.burst.begins + self.burst.interval
        return played(numbers[: self.shared], self.moving, self.burst.table, self.values(numbers), LAWS, seconds)

    def within(self, numbers: FloatArray) -> FloatArray:
        """The numbers with the shared ones inside their bounds."""
        found = numbers.copy()
        found[self.shared :] = np.clip(found[self.shared :], *self.bounds)
        return found

    def apart(self, numbers: FloatArray) -> FloatArray:
        """The numbers with lying balls that overlap moved apart, until none does."""
        found = numbers.copy()
        places = found[MOVING : self.shared].reshape(-1, 2)
        one, two = self.neighbours
        reach = 2 * self.burst.table.ball_radius * found[-1] + OVERLAP_SIGMA
        for _ in range(_PUSHES):
            between = places[two] - places[one]
            far = np.linalg.norm(between, axis=1)
            lack = np.minimum(far - reach, 0.0)
            if not lack.any():
                break
            push = (0.5 * lack / far)[:, None] * between
            np.add.at(places, one, push)
            np.add.at(places, two, -push)
        return found

    def missed(self, numbers: FloatArray) -> tuple[FloatArray, Run]:
        """In standard deviations, (R,): of the samples seen, of what is known beforehand, and of the gaps."""
        burst, rows, run = self.burst, self.rows, self.run(numbers)
        moments, which = np.unique(burst.t[rows], return_inverse=True)
        there = run.at(moments - burst.begins)[which, burst.ball[rows], :2]
        seen = np.einsum("kij,kj->ki", burst.whiten[rows], there - burst.xy[rows])
        value, sigma = self.usual
        gap, scale, _ = self._gaps(numbers)
        return np.concatenate([seen.ravel(), (numbers - value) / sigma, gap / scale]), run

    def slopes(self, numbers: FloatArray, run: Run) -> FloatArray:
        """Derivatives (R, P) of what `missed` gives."""
        burst, rows = self.burst, self.rows
        moments, which = np.unique(burst.t[rows], return_inverse=True)
        place = np.full((len(moments), len(burst.balls)), -1)
        place[which, burst.ball[rows]] = np.arange(len(rows))
        moved = run.along(moments - burst.begins, place, self.directions(numbers), LYING)
        seen = np.einsum("kij,kjp->kip", burst.whiten[rows], moved).reshape(-1, len(numbers))
        _, scale, towards = self._gaps(numbers)
        one, two = self.neighbours
        gaps, row = np.zeros((len(one), len(numbers))), np.arange(len(one))
        for axis in range(2):
            gaps[row, MOVING + LYING * two + axis] = towards[:, axis]
            gaps[row, MOVING + LYING * one + axis] = -towards[:, axis]
        gaps[:, -1] = -2 * burst.table.ball_radius
        return np.concatenate([seen, np.diag(1 / self.usual[1]), gaps / scale[:, None]])

    def directions(self, numbers: FloatArray) -> FloatArray:
        """What the engine's numbers change by when one of these does, see `playing.directions_of`."""
        values = self.values(numbers)
        balls = balls_of(numbers[: self.shared], self.moving, self.burst.table, values)
        return directions_of(balls, self.moving, self.burst.table, values, np.array(SOUGHT))

    def weights(self, missed: FloatArray) -> tuple[FloatArray, float]:
        """Weights (R,) and cost: Huber's loss over the samples, squares for the rest."""
        count = 2 * len(self.rows)
        of_samples, cost = huber(missed[:count].reshape(-1, 2))
        weight = np.concatenate([np.repeat(of_samples, 2), np.ones(len(missed) - count)])
        return weight, cost + float(np.sum(missed[count:] ** 2))

    def _gaps(self, numbers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Between neighbours (G,) m, their standard deviations (G,), and directions (G, 2) from one to the other."""
        one, two = self.neighbours
        places = numbers[MOVING : self.shared].reshape(-1, 2)
        between = places[two] - places[one]
        far = np.linalg.norm(between, axis=1)
        gap = far - 2 * self.burst.table.ball_radius * numbers[-1]
        return gap, np.where(gap < 0, OVERLAP_SIGMA, GAP_SIGMA), between / far[:, None]
