"""What is known of a shot at a moment: every ball's state, cloth and cushions, with the covariance of all together.

It comes from the joint fit of what was seen until then, so that the errors of speeds and of friction, which a
prediction adds up, keep their correlation. What no picture tells has an honest spread instead: spin about the vertical,
the level of the table, the law of the cushions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.billiards.contacts import rebound
from models.billiards.free_paths import ROLLING_SHARE, SLOPE, UNEVENNESS
from models.billiards.motion import GRAVITY, STATE, kinematics_jacobian, rolling_spin
from models.billiards.parameters import (
    BALL_E,
    BALL_LAWS,
    CUSHION_E,
    CUSHION_E_SLOPE,
    CUSHION_LAWS,
    CUSHION_MU,
    NAMES,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    SPIN_DECAY,
    Physics,
    neutral,
)
from models.billiards.simulate import Balls, Run, simulate
from models.errors import TrackError
from models.fit import Trust
from models.fitting import fit_and_solution
from models.knowledge import BALL_RESTITUTION
from models.refinement import ROLLING_RANGE, SLIDING_RANGE
from models.scene import Scene, Table
from models.solution import Solution, layout
from models.story import Span
from models.tracks import Tracks

Floats = NDArray[np.float64]

PER_BALL = 7
"""Numbers of a ball: x, y (m), vx, vy, slip ux, uy, surface speed of its side spin R wz (m/s)."""
SHARED = 14
"""ln sliding mu, ln rolling mu, slope x, y (mm/m), diameter, four noses (m), restitution of cushions and its change
with speed (s/m), restitution of balls, ln friction of cushions, ln decay of side spin."""
FEWEST = 5
"""pictures that speeds can be told from."""
SIDE_SPIN = 0.3
"""standard deviation of the surface speed of side spin after a contact, over the speed of the ball."""
LEAST_SIDE_SPIN = 0.02
DECAY, DECAY_SIGMA = 10.0, 0.4
"""rad/s^2, and of its logarithm."""
NOSE_FRICTION, NOSE_FRICTION_SIGMA = 0.18, 0.4
"""Coulomb friction between ball and nose (Marlow 1995: 0.14 to 0.2), sigma of its logarithm."""
RETURN_SCATTER = 0.05
"""of the restitution: what real cushions add to every law."""
CENTRAL_LAW = "mathavan_2010"
RETURNED = (0.3, 0.98)
"""share of its speed with which a ball can leave a cushion."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """N balls at a moment; D = 7 N + 14 numbers."""

    t: float
    """s."""
    ids: tuple[str, ...]
    table: Table
    mean: Floats
    """(D,)"""
    covariance: Floats
    """(D, D)"""
    moving: NDArray[np.bool_]
    """(N,)"""
    trust: Trust
    """in the fit that it comes from."""

    @property
    def places(self) -> NDArray[np.int64]:
        """(2N,) columns of x and y of all balls."""
        return (PER_BALL * np.arange(len(self.ids))[:, None] + np.arange(2)).ravel()

    def inputs(self, numbers: Floats, law: str) -> Floats:
        """What a simulation starts from (9N + 17,), in the order of `Run.columns`, out of D numbers."""
        n, shared = len(self.ids), numbers[-SHARED:]
        state, radius = numbers[:-SHARED].reshape(n, PER_BALL), self.table.ball_radius
        size = radius * shared[4]
        balls = np.column_stack(
            [state[:, :4], rolling_spin(state[:, 2:4], state[:, 4:6], size), state[:, 6] / size, np.full(n, size),
             np.full(n, self.table.ball_mass)]
        )  # fmt: skip
        p = neutral()
        p[[SLIDING_MU, ROLLING_MU]] = np.clip(np.exp(shared[:2]), *np.transpose([SLIDING_RANGE, ROLLING_RANGE]))
        p[[SLOPE_X, SLOPE_Y]] = shared[2:4]
        p[CUSHION_E] = _restitution(law, float(np.clip(shared[9], *RETURNED)))
        p[[CUSHION_E_SLOPE, BALL_E]] = -shared[10], min(shared[11], 1.0)
        p[[CUSHION_MU, SPIN_DECAY]] = np.exp(shared[12:14])
        return np.concatenate([balls.ravel(), p, size - radius - shared[5:9]])

    def play(self, inputs: Floats, law: str, seconds: float) -> Run:
        """The future from given inputs."""
        n = len(self.ids)
        columns = inputs[: 9 * n].reshape(n, 9)
        p, offsets = inputs[9 * n : 9 * n + len(NAMES)], inputs[9 * n + len(NAMES) :]
        balls = Balls(self.ids, columns[:, :7].copy(), columns[:, 7].copy(), columns[:, 8].copy())
        return simulate(balls, self.table, Physics(p.copy(), NAMES, law, BALL_LAWS[2]), seconds, offsets)


def outlook_at(tracks: Tracks, scene: Scene, t: float) -> Outlook:
    """What was known at t (s): only what was seen until then is fitted. TrackError where that tells nothing."""
    seen = tracks.until(t)
    if len(seen.t) < FEWEST:
        raise TrackError(f"{len(seen.t)} pictures were seen until {t:g} s; a prediction needs at least {FEWEST}")
    fit, solution = fit_and_solution(seen, scene)
    if solution is None:
        raise TrackError(f"physics could not be fitted to what was seen until {t:g} s; {fit.trust.reasons[0]}")
    events = fit.events
    gone = {a for a, kind in zip(events.a, events.kind, strict=True) if kind == "pocket"}
    return outlook(solution, seen.ids, t, scene.table, gone, fit.trust)


def outlook(solution: Solution, ids: tuple[str, ...], t: float, table: Table, gone: set[str], trust: Trust) -> Outlook:
    """What a fit of everything up to t (s) knows then; `gone` balls have been potted."""
    shift, covariance = _levelled(solution)
    story = solution.story
    balls = [k for k, name in enumerate(ids) if name not in gone and story.of_ball(k)]
    size = PER_BALL * len(balls) + SHARED
    mean, by = np.zeros(size), np.zeros((size, len(covariance)))
    side = np.zeros(size)
    moving = np.zeros(len(balls), bool)
    for row, ball in enumerate(balls):
        span = story.of_ball(ball)[-1]
        here = slice(PER_BALL * row, PER_BALL * row + 6)
        mean[here], by[here], moving[row] = _state(solution, span, t, len(covariance))
        if moving[row]:
            side[PER_BALL * row + 6] = _side_spin(story.spans[span], t - story.begin(span), table.ball_radius)
    _shared(solution, mean, by)
    known = by @ covariance @ by.T + np.diag(side**2)
    known[np.diag_indices(SHARED)[0] - SHARED, np.diag_indices(SHARED)[1] - SHARED] += _unseen()
    names = tuple(ids[k] for k in balls)
    return Outlook(t, names, table, mean + by @ shift, (known + known.T) / 2, moving, trust)


def _levelled(solution: Solution) -> tuple[Floats, Floats]:
    """How the numbers of a fit move (P + 2,), and their covariance (P + 2, P + 2) with two more for the slope of the
    table (m/s^2): the extra accelerations of all spans are one slope, but for an uneven cloth."""
    plan, story = layout(solution.story), solution.story
    covariance = np.zeros((plan.size + 2, plan.size + 2))
    covariance[:-2, :-2] = solution.covariance
    covariance[-2:, -2:] = np.eye(2) * (SLOPE * _per_slope()) ** 2
    moving = [k for k, span in enumerate(story.spans) if not span.static]
    if not moving:
        return np.zeros(plan.size + 2), covariance
    tied = np.zeros((2 * len(moving), plan.size + 2))
    for row, k in enumerate(moving):
        for axis in range(2):
            tied[2 * row + axis, plan.span[k] + 6 + axis] = 1.0
            tied[2 * row + axis, plan.size + axis] = -1.0
    apart = np.concatenate([story.spans[k].state[6:8] for k in moving])
    gain = np.linalg.solve(tied @ covariance @ tied.T + UNEVENNESS**2 * np.eye(len(tied)), tied @ covariance).T
    return -gain @ apart, covariance - gain @ tied @ covariance


def _per_slope() -> float:
    """m/s^2 that a rolling ball feels of a slope of 1 mm/m."""
    return ROLLING_SHARE * GRAVITY * 1e-3


def _state(solution: Solution, span: int, t: float, columns: int) -> tuple[Floats, Floats, bool]:
    """Place, velocity and slip (6,) of a ball at t, their derivatives (6, columns), and whether it moves."""
    plan, described = layout(solution.story), solution.story.spans[span]
    first, by = int(plan.span[span]), np.zeros((6, columns))
    if described.static:
        by[[0, 1], [first, first + 1]] = 1.0
        return np.concatenate([described.state[:2], np.zeros(4)]), by, False
    tau = np.array([max(t - solution.story.begin(span), 0.0)])
    value, slope = kinematics_jacobian(described.state[None], tau, solution.friction)
    by[:, first : first + STATE] = slope[0, :, :STATE]
    by[:, plan.globals : plan.globals + 2] = slope[0, :, STATE + 1 :]
    if described.start is not None:
        by[:, plan.contact + described.start] = -slope[0, :, STATE]
    return value[0], by, bool(np.hypot(*value[0, 2:4]) > 0)


def _side_spin(span: Span, since: float, radius: float) -> float:
    """Standard deviation of the surface speed of side spin, m/s, some time after a contact."""
    speed = float(np.hypot(*span.state[2:4]))
    return max(SIDE_SPIN * speed - DECAY * radius * since, LEAST_SIDE_SPIN * speed)


def _shared(solution: Solution, mean: Floats, by: Floats) -> None:
    """Fill in what all balls share."""
    plan = layout(solution.story)
    friction = solution.friction
    mean[-SHARED:] = [
        np.log(friction.sliding), np.log(friction.rolling), 0.0, 0.0, solution.diameter, *solution.nose,
        *solution.rubber[:2], BALL_RESTITUTION[0], np.log(NOSE_FRICTION), np.log(DECAY),
    ]  # fmt: skip
    first = len(mean) - SHARED
    for row, column in ((0, 0), (1, 1), *((4 + k, 2 + k) for k in range(7))):
        by[first + row, plan.globals + column] = 1.0
    by[first + 2, -2] = by[first + 3, -1] = 1 / _per_slope()


def _unseen() -> Floats:
    """(SHARED,) variances of what the fit says nothing of."""
    variance = np.zeros(SHARED)
    variance[9] = RETURN_SCATTER**2
    variance[11:] = BALL_RESTITUTION[1] ** 2, NOSE_FRICTION_SIGMA**2, DECAY_SIGMA**2
    return variance


def _restitution(law: str, returned: float) -> float:
    """The restitution by which a law sends a ball that rolls straight into a cushion back at a share of its speed."""
    grid, shares = _returns(law)
    return float(np.interp(returned, shares, grid))


@cache
def _returns(law: str) -> tuple[Floats, Floats]:
    """Restitutions (G,), and the share of its speed (G,) that a ball keeps which rolls at 1 m/s into a cushion."""
    grid, radius = np.linspace(0.2, 1.0, 41), 0.028575
    shares = np.empty_like(grid)
    for k, e in enumerate(grid):
        p = neutral()
        p[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = 0.2, e, NOSE_FRICTION
        shares[k] = -rebound(CUSHION_LAWS.index(law), 1.0, 0.0, 0.0, 1.0 / radius, 0.0, radius, 0.17, p)[0]
    return grid, np.asarray(np.maximum.accumulate(shares))
