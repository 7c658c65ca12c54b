"""What is known of a shot at a moment: every ball's state, cloth and cushions, with the covariance of all together,
and how a simulation starts from there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Trust
from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.joint_refinement import ROLLING_RANGE, SLIDING_RANGE
from models.physics.billiards.cloth.closed_form_motion import rolling_spin
from models.physics.billiards.parameters import (
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
from models.physics.billiards.simulation.contact_resolution import rebound
from models.physics.billiards.simulation.simulate_shot import Balls, Run, simulate

PER_BALL = 7
"""Numbers of a ball: x, y (m), vx, vy, slip ux, uy, surface speed of its side spin R wz (m/s)."""
SHARED = 14
"""ln sliding mu, ln rolling mu, slope x, y (mm/m), diameter, four noses (m), restitution of cushions and its change
with speed (s/m), restitution of balls, ln friction of cushions, ln decay of side spin."""
NOSE_FRICTION = 0.18
"""Coulomb friction between ball and nose."""
GRIP_SCATTER = 0.3
"""of the grip of real cushions about that of a law."""
RETURNED = (0.3, 0.98)
"""share of its speed with which a ball can leave a cushion."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """N balls at a moment; D = 7 N + 14 numbers."""

    t: float
    """s."""
    ids: tuple[str, ...]
    table: Table
    mean: FloatArray
    """(D,)"""
    covariance: FloatArray
    """(D, D)"""
    moving: NDArray[np.bool_]
    """(N,)"""
    trust: Trust
    """in the fit that it comes from."""
    laws: FloatArray
    """(L,) probabilities of `CUSHION_LAWS`."""

    @property
    def central_law(self) -> str:
        """The most probable one."""
        return CUSHION_LAWS[int(np.argmax(self.laws))]

    @property
    def places(self) -> NDArray[np.int64]:
        """(2N,) columns of x and y of all balls."""
        return (PER_BALL * np.arange(len(self.ids))[:, None] + np.arange(2)).ravel()

    def inputs(self, numbers: FloatArray, law: str) -> FloatArray:
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

    def play(self, inputs: FloatArray, law: str, seconds: float) -> Run:
        """The future from given inputs."""
        n = len(self.ids)
        columns = inputs[: 9 * n].reshape(n, 9)
        p, offsets = inputs[9 * n : 9 * n + len(NAMES)], inputs[9 * n + len(NAMES) :]
        balls = Balls(self.ids, columns[:, :7].copy(), columns[:, 7].copy(), columns[:, 8].copy())
        return simulate(balls, self.table, Physics(p.copy(), NAMES, law, BALL_LAWS[2]), seconds, offsets)


def law_probabilities(grip: float, sigma: float) -> FloatArray:
    """(L,) of `CUSHION_LAWS`, by how far the cushions seen so far stopped a ball's spin about their own line."""
    apart = np.array([_grip(law) for law in CUSHION_LAWS]) - grip
    weight = np.exp(-0.5 * (apart**2 - (apart**2).min()) / (sigma**2 + GRIP_SCATTER**2))
    return np.asarray(weight / weight.sum(), np.float64)


def _grip(law: str) -> float:
    """How far a cushion stops the spin of a ball that rolls straight into it: 0 not at all, 1 until no slip is left."""
    speed, spin = _rolled_into(law, 0.85)
    return (1.0 - spin) / speed


def _restitution(law: str, returned: float) -> float:
    """The restitution by which a law sends a ball that rolls straight into a cushion back at a share of its speed."""
    grid, shares = _returns(law)
    return float(np.interp(returned, shares, grid))


@cache
def _returns(law: str) -> tuple[FloatArray, FloatArray]:
    """Restitutions (G,), and the share of its speed (G,) that a ball keeps which rolls at 1 m/s into a cushion."""
    grid = np.linspace(0.2, 1.0, 41)
    shares = np.array([_rolled_into(law, e)[0] for e in grid])
    return grid, np.asarray(np.maximum.accumulate(shares))


def _rolled_into(law: str, e: float) -> tuple[float, float]:
    """What a ball that rolls at 1 m/s straight into a cushion leaves with: its speed, and the surface speed of its spin
    about the line of the cushion, which was 1."""
    p, radius = neutral(), 0.028575
    p[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = 0.2, e, NOSE_FRICTION
    after = rebound(CUSHION_LAWS.index(law), 1.0, 0.0, 0.0, 1.0 / radius, 0.0, radius, 0.17, p)
    return -float(after[0]), radius * float(after[3])
