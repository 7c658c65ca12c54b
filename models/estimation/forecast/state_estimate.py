"""State of all balls, cloth and cushions at a moment, with their joint covariance, as input of a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Trust
from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.joint_refinement import ROLLING_RANGE, SLIDING_RANGE
from models.estimation.table_learning.learned_table import LearnedTable
from models.estimation.table_learning.side_spin import SpinDistribution
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.cloth.closed_form_motion import spin_from_slip
from models.physics.billiards.contact_models import BALL_MODELS, CUSHION_MODELS
from models.physics.billiards.parameter_vector import (
    BALL_E,
    CUSHION_E,
    CUSHION_E_SLOPE,
    CUSHION_MU,
    PARAMETER_NAMES,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    SPIN_DECAY,
    neutral_parameters,
)
from models.physics.billiards.simulation.contact_resolution import rebound
from models.physics.billiards.simulation.simulate_shot import NO_DISTURBANCES, BallSet, SimulatedShot, simulate
from models.physics.billiards.simulation.table_physics import Physics

# Parameters of a ball: x, y (m), vx, vy, slip ux, uy, surface speed of its side spin R wz (m/s).
PARAMETERS_PER_BALL = 7
# ln sliding mu, ln rolling mu, slope x, y (mm/m), diameter, four noses (m), restitution of cushions and its change with
# speed (s/m), restitution of balls, ln friction of cushions, ln decay of side spin.
SHARED_COUNT = 14
# Coulomb friction between ball and nose.
NOSE_FRICTION = 0.18
# Of the grip of real cushions about that of a law.
GRIP_SCATTER = 0.3
# Share of its speed with which a ball can leave a cushion.
RETURN_SPEED_RANGE = (0.3, 0.98)


@dataclass(frozen=True, slots=True)
class StateEstimate:
    """Estimated state of N balls at a moment; D = 7 N + 14 parameters."""

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
    """Trust level of the fit that it comes from."""
    laws: FloatArray
    """(L,) probabilities of `CUSHION_MODELS`."""
    learned: LearnedTable | None = None
    """What other shots taught about the table; it replaces the mixture of cushion laws and their parameters."""
    spins: tuple[SpinDistribution | None, ...] = ()
    """(N,) side spin of each ball where the table is learned; None for a ball at rest."""

    @property
    def most_probable_law(self) -> str:
        """The most probable cushion law."""
        return CUSHION_MODELS[int(np.argmax(self.laws))]

    @property
    def place_columns(self) -> NDArray[np.int64]:
        """(2N,) columns of x and y of all balls."""
        return (PARAMETERS_PER_BALL * np.arange(len(self.ids))[:, None] + np.arange(2)).ravel()

    def simulation_inputs(self, parameters: FloatArray, law: str) -> FloatArray:
        """Convert D parameters to the simulation inputs (9N + 17,), as `directional_derivatives` takes them."""
        n, shared = len(self.ids), parameters[-SHARED_COUNT:]
        state, radius = parameters[:-SHARED_COUNT].reshape(n, PARAMETERS_PER_BALL), self.table.ball_radius
        size = radius * shared[4]
        balls = np.column_stack(
            [state[:, :4], spin_from_slip(state[:, 2:4], state[:, 4:6], size), state[:, 6] / size, np.full(n, size),
             np.full(n, self.table.ball_mass)]
        )  # fmt: skip
        physics = neutral_parameters() if self.learned is None else self.learned.physics.copy()
        physics[[SLIDING_MU, ROLLING_MU]] = np.clip(np.exp(shared[:2]), *np.transpose([SLIDING_RANGE, ROLLING_RANGE]))
        physics[[SLOPE_X, SLOPE_Y]] = shared[2:4]
        if self.learned is not None:
            physics[BALL_E] = min(shared[11], 1.0)
            return np.concatenate([balls.ravel(), physics, size - radius - shared[5:9]])
        physics[CUSHION_E] = _equivalent_restitution(law, float(np.clip(shared[9], *RETURN_SPEED_RANGE)))
        physics[[CUSHION_E_SLOPE, BALL_E]] = -shared[10], min(shared[11], 1.0)
        physics[[CUSHION_MU, SPIN_DECAY]] = np.exp(shared[12:14])
        return np.concatenate([balls.ravel(), physics, size - radius - shared[5:9]])

    def simulate_ahead(
        self, inputs: FloatArray, law: str, seconds: float, disturbances: FloatArray = NO_DISTURBANCES
    ) -> SimulatedShot:
        """Simulate the future from given inputs; `disturbances` (D, 5) are those of `simulate`."""
        balls, physics, offsets, correction = self.convert_inputs(inputs, law)
        return simulate(balls, self.table, physics, seconds, offsets, disturbances, correction)

    def convert_inputs(self, inputs: FloatArray, law: str) -> tuple[BallSet, Physics, FloatArray, FloatArray]:
        """Convert simulation inputs to balls, physics, nose offsets (4,) m, and the correction of the cushion law."""
        n = len(self.ids)
        columns = inputs[: 9 * n].reshape(n, 9)
        p, offsets = inputs[9 * n : 9 * n + len(PARAMETER_NAMES)], inputs[9 * n + len(PARAMETER_NAMES) :]
        balls = BallSet(self.ids, columns[:, :7].copy(), columns[:, 7].copy(), columns[:, 8].copy())
        physics = Physics(p.copy(), PARAMETER_NAMES, law, BALL_MODELS[2])
        correction = NO_CORRECTION if self.learned is None else self.learned.correction
        return balls, physics, offsets, correction


def law_probabilities(grip: float, sigma: float) -> FloatArray:
    """Evaluate the probabilities (L,) of `CUSHION_MODELS` from the grip of the observed cushion contacts."""
    difference = np.array([_grip_of_law(law) for law in CUSHION_MODELS]) - grip
    weight = np.exp(-0.5 * (difference**2 - (difference**2).min()) / (sigma**2 + GRIP_SCATTER**2))
    return np.asarray(weight / weight.sum(), np.float64)


def _grip_of_law(law: str) -> float:
    """Return how far a cushion stops the spin of a straight rolling ball: 0 not at all, 1 until it sticks."""
    speed, spin = _rebound_of_rolling_ball(law, 0.85)
    return (1.0 - spin) / speed


def _equivalent_restitution(law: str, returned: float) -> float:
    """Return the restitution for which a law returns a straight rolling ball at a share of its speed."""
    grid, shares = _return_speed_table(law)
    return float(np.interp(returned, shares, grid))


@cache
def _return_speed_table(law: str) -> tuple[FloatArray, FloatArray]:
    """Tabulate restitutions (G,) and the share of its speed (G,) that a ball keeps at a cushion.

    The ball rolls straight into the cushion at 1 m/s.
    """
    grid = np.linspace(0.2, 1.0, 41)
    shares = np.array([_rebound_of_rolling_ball(law, e)[0] for e in grid])
    return grid, np.asarray(np.maximum.accumulate(shares))


def _rebound_of_rolling_ball(law: str, e: float) -> tuple[float, float]:
    """Return the speed after a ball rolls at 1 m/s straight into a cushion, and the surface speed of its spin.

    The spin is that about the line of the cushion; its surface speed was 1.
    """
    physics, radius = neutral_parameters(), 0.028575
    physics[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = 0.2, e, NOSE_FRICTION
    after = rebound(CUSHION_MODELS.index(law), 1.0, 0.0, 0.0, 1.0 / radius, 0.0, radius, 0.17, physics)
    return -float(after[0]), radius * float(after[3])
