"""Simulation of a break shot from its parameters, with residuals and their derivatives.

The parameters are the state of the incoming ball, the place of every other one, friction and restitution, and the
distance at which balls touch. Displacements of half a millimetre in a rack decide which balls meet, and no camera
resolves them; but they follow from where the balls go.

Data of a break are the balls that lie together, one that comes in, and their observations before and shortly after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.numerics.statistics import evaluate_pair_loss
from models.physics.billiards.simulation.parametrised_shot import (
    MOVING_BALL_SIZE,
    NEUTRAL_SHOT_PARAMETERS,
    RADIUS_FACTOR,
    RESTING_BALL_SIZE,
    SHOT_PARAMETERS,
    ContactModels,
    build_balls,
    build_directions,
    simulate_start,
)
from models.physics.billiards.simulation.simulated_shot import SimulatedShot
from models.physics.effects.billiards_catalogue import find_prior


@dataclass(frozen=True, slots=True)
class BreakShot:
    """A break shot of N resting balls and the incoming one, which has index 0 here."""

    balls: tuple[int, ...]
    """(N + 1,) ball indices in the tracks."""
    start: float
    """s, from which the incoming ball is tracked."""
    hit: float
    """s, approximate time at which it meets the others."""
    incoming_state: FloatArray
    """(7,) its state at `start`: place, velocity, slip, surface speed of side spin (m, m/s)."""
    incoming_sigma: FloatArray
    """(7,) infinite where the samples alone determine it."""
    rest_places: FloatArray
    """(N, 2) m, places of the others."""
    rest_sigma: FloatArray
    """(N,) m per axis."""
    t: FloatArray
    """(K,) s, of the observations: the incoming ball from `start` on, the others after the hit; each until it meets a
    cushion or falls.
    """
    ball: IntArray
    """(K,) index among the balls here."""
    xy: FloatArray
    """(K, 2) m."""
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""
    interval: float
    """s between two frames."""
    friction: tuple[float, float]
    """Of sliding and rolling on this cloth, estimated from the clip."""
    diameter: float
    """Distance at which balls touch, over two radii, estimated from the clip."""
    table: Table
    rack: tuple[int, ...] = ()
    """Ball indices in the tracks of the resting balls that lie together."""

    @property
    def speed(self) -> float:
        """m/s of the incoming ball."""
        return float(np.hypot(*self.incoming_state[2:4]))

    def inflate_noise(self, factor: float) -> BreakShot:
        """Return the same break shot with `factor` times the noise."""
        return replace(self, whiten=self.whiten / factor)

    @property
    def end(self) -> float:
        """s, of the last observation."""
        return float(self.t.max())


# Cushions hardly matter: a ball is tracked until it meets one.
CONTACT_LAWS = ContactModels("mathavan_2010", "alciatore")
# Shared parameters; other properties of the cloth are negligible within a tenth of a second.
FITTED_PARAMETERS = (
    SHOT_PARAMETERS.index("sliding_friction.mu"),
    SHOT_PARAMETERS.index("ball_restitution.e"),
    RADIUS_FACTOR,
)
# Of the distance of touching balls, beside the estimate of the whole clip.
FACTOR_SIGMA = 0.005
# m between the surfaces of two balls that were set to touch, by their measured places.
NEIGHBOUR_GAP = 4e-3
# m, remaining gap between balls that were set to touch.
GAP_SIGMA = 6e-4
# m: balls do not overlap.
OVERLAP_SIGMA = 2e-5
# Shares of the speed of the incoming ball.
SLIP_SIGMA, SIDE_SIGMA = 0.5, 0.35
# Rounds in which overlapping balls move apart.
_MAX_PUSHES = 60


@dataclass(frozen=True)
class BreakModel:
    """The model of a break; parameters (P,): 7 of the incoming ball, 2 of each other one, `FITTED_PARAMETERS`."""

    break_shot: BreakShot
    until: float
    """s: later observations are not used."""

    @cached_property
    def is_moving(self) -> NDArray[np.bool_]:
        """(N + 1,) True for the incoming ball."""
        return np.asarray(np.arange(len(self.break_shot.balls)) == 0)

    @cached_property
    def common_column(self) -> int:
        """First column of the shared parameters."""
        return MOVING_BALL_SIZE + RESTING_BALL_SIZE * (len(self.break_shot.balls) - 1)

    @cached_property
    def rows(self) -> IntArray:
        """Rows of the observations that are used."""
        return np.flatnonzero(self.break_shot.t <= self.until)

    @cached_property
    def neighbours(self) -> tuple[IntArray, IntArray]:
        """Pairs of resting balls that were set to touch."""
        places = self.break_shot.rest_places
        gaps = np.linalg.norm(places[:, None] - places, axis=2) - 2 * self.break_shot.table.ball_radius
        one, two = np.nonzero(np.triu(gaps < NEIGHBOUR_GAP, 1))
        return one, two

    @cached_property
    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Prior means (P,) and standard deviations; infinite without a prior."""
        break_shot, size = self.break_shot, self.common_column + len(FITTED_PARAMETERS)
        value, sigma = np.empty(size), np.full(size, np.inf)
        value[:MOVING_BALL_SIZE], sigma[:MOVING_BALL_SIZE] = break_shot.incoming_state, break_shot.incoming_sigma
        sigma[4:6] = np.minimum(sigma[4:6], SLIP_SIGMA * break_shot.speed)
        sigma[6] = min(float(sigma[6]), SIDE_SIGMA * break_shot.speed)
        value[MOVING_BALL_SIZE : self.common_column] = break_shot.rest_places.ravel()
        sigma[MOVING_BALL_SIZE : self.common_column] = np.repeat(break_shot.rest_sigma, RESTING_BALL_SIZE)
        sliding, restitution = find_prior("sliding_friction", "mu"), find_prior("ball_restitution", "e")
        value[self.common_column :] = [break_shot.friction[0], restitution.value, break_shot.diameter]
        sigma[self.common_column :] = [sliding.sigma * sliding.value, restitution.sigma, FACTOR_SIGMA]
        return value, sigma

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the shared parameters."""
        sliding, restitution = find_prior("sliding_friction", "mu"), find_prior("ball_restitution", "e")
        low, high = zip(sliding.bounds, restitution.bounds, (0.95, 1.05), strict=True)
        return np.array(low), np.array(high)

    def physics_values(self, parameters: FloatArray) -> FloatArray:
        """Return (Q,) all parameters of `parametrised_shot`."""
        values = NEUTRAL_SHOT_PARAMETERS.copy()
        for effect, parameter in (("spin_decay", "rate"), ("cushion_restitution", "e"), ("cushion_friction", "mu")):
            values[SHOT_PARAMETERS.index(f"{effect}.{parameter}")] = find_prior(effect, parameter).value
        values[SHOT_PARAMETERS.index("rolling_resistance.mu")] = self.break_shot.friction[1]
        values[list(FITTED_PARAMETERS)] = parameters[self.common_column :]
        return values

    def simulate(self, parameters: FloatArray) -> SimulatedShot:
        """Simulate the shot from its start; raise ArithmeticError where contacts do not end."""
        seconds = min(self.until, self.break_shot.end) - self.break_shot.start + self.break_shot.interval
        start, values = parameters[: self.common_column], self.physics_values(parameters)
        return simulate_start(start, self.is_moving, self.break_shot.table, values, CONTACT_LAWS, seconds)

    def clip_to_bounds(self, parameters: FloatArray) -> FloatArray:
        """Clip the shared parameters to their bounds."""
        clipped = parameters.copy()
        clipped[self.common_column :] = np.clip(clipped[self.common_column :], *self.bounds)
        return clipped

    def make_feasible(self, parameters: FloatArray) -> FloatArray:
        """Clip the shared parameters to their bounds, and move overlapping resting balls apart."""
        return self.separate_balls(self.clip_to_bounds(parameters))

    def separate_balls(self, parameters: FloatArray) -> FloatArray:
        """Move overlapping resting balls apart, until none overlap."""
        separated = parameters.copy()
        places = separated[MOVING_BALL_SIZE : self.common_column].reshape(-1, 2)
        one, two = self.neighbours
        reach = 2 * self.break_shot.table.ball_radius * separated[-1] + OVERLAP_SIGMA
        for _ in range(_MAX_PUSHES):
            between = places[two] - places[one]
            distance = np.linalg.norm(between, axis=1)
            overlap = np.minimum(distance - reach, 0.0)
            if not overlap.any():
                break
            push = (0.5 * overlap / distance)[:, None] * between
            np.add.at(places, one, push)
            np.add.at(places, two, -push)
        return separated

    def evaluate_residuals(self, parameters: FloatArray) -> tuple[FloatArray, SimulatedShot]:
        """Evaluate the residuals (R,) of observations, priors and gaps, in standard deviations, and the simulation."""
        break_shot, rows, run = self.break_shot, self.rows, self.simulate(parameters)
        moments, moment_index = np.unique(break_shot.t[rows], return_inverse=True)
        places = run.states_at(moments - break_shot.start)[moment_index, break_shot.ball[rows], :2]
        sample_residual = np.einsum("kij,kj->ki", break_shot.whiten[rows], places - break_shot.xy[rows])
        value, sigma = self.prior
        gap, scale, _ = self._neighbour_gaps(parameters)
        return np.concatenate([sample_residual.ravel(), (parameters - value) / sigma, gap / scale]), run

    def evaluate_jacobian(self, parameters: FloatArray, run: SimulatedShot) -> FloatArray:
        """Evaluate the derivatives (R, P) of the residuals."""
        break_shot, rows = self.break_shot, self.rows
        moments, moment_index = np.unique(break_shot.t[rows], return_inverse=True)
        place = np.full((len(moments), len(break_shot.balls)), -1)
        place[moment_index, break_shot.ball[rows]] = np.arange(len(rows))
        derivatives = run.directional_derivatives(
            moments - break_shot.start, place, self.state_directions(parameters), RESTING_BALL_SIZE
        )
        sample_jacobian = np.einsum("kij,kjp->kip", break_shot.whiten[rows], derivatives).reshape(-1, len(parameters))
        _, scale, towards = self._neighbour_gaps(parameters)
        one, two = self.neighbours
        gaps, row = np.zeros((len(one), len(parameters))), np.arange(len(one))
        for axis in range(2):
            gaps[row, MOVING_BALL_SIZE + RESTING_BALL_SIZE * two + axis] = towards[:, axis]
            gaps[row, MOVING_BALL_SIZE + RESTING_BALL_SIZE * one + axis] = -towards[:, axis]
        gaps[:, -1] = -2 * break_shot.table.ball_radius
        return np.concatenate([sample_jacobian, np.diag(1 / self.prior[1]), gaps / scale[:, None]])

    def state_directions(self, parameters: FloatArray) -> FloatArray:
        """Return the change of the engine's parameters with each of these, see `parametrised_shot`."""
        values = self.physics_values(parameters)
        balls = build_balls(parameters[: self.common_column], self.is_moving, self.break_shot.table, values)
        return build_directions(
            balls.state, balls.radius, self.is_moving, self.break_shot.table, values, np.array(FITTED_PARAMETERS)
        )

    def huber_weights(self, residual: FloatArray) -> tuple[FloatArray, float]:
        """Return weights (R,) and cost: Huber's loss over the samples, squares for the rest."""
        return evaluate_pair_loss(residual, 2 * len(self.rows))

    def _neighbour_gaps(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gaps between neighbours (G,) m, their sigmas (G,), and directions (G, 2) from one to the other."""
        one, two = self.neighbours
        places = parameters[MOVING_BALL_SIZE : self.common_column].reshape(-1, 2)
        between = places[two] - places[one]
        distance = np.linalg.norm(between, axis=1)
        gap = distance - 2 * self.break_shot.table.ball_radius * parameters[-1]
        return gap, np.where(gap < 0, OVERLAP_SIGMA, GAP_SIGMA), between / distance[:, None]
