"""States of the balls with their common covariance, and functions of them with standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.core.contact_graph import JointSolution, layout_parameters
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import LONGEST_MOTION
from models.estimation.table_learning.cushion_contacts import evaluate_segment_state

# Step of numerical derivatives, m or m/s: far below every uncertainty, far above rounding.
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class LinearState:
    """K numbers with their derivatives by the P parameters of a fit."""

    value: FloatArray
    """(K,) m or m/s."""
    jacobian: FloatArray
    """(K, P)"""


@dataclass(frozen=True, slots=True)
class PosteriorView:
    """A joint fit with the covariance that its residuals justify."""

    solution: JointSolution
    covariance: FloatArray
    """(P, P) of the packed parameters."""
    radius: float
    """m, of a ball."""

    def state_at_start(self, segment: int) -> LinearState:
        """Return place, velocity and slip (6,) where a segment begins."""
        graph = self.solution.graph
        return self.state_at(segment, graph.start_time(segment), graph.segments[segment].start)

    def state_at_end(self, segment: int) -> LinearState:
        """Return place, velocity and slip (6,) where a segment ends."""
        graph = self.solution.graph
        return self.state_at(segment, self.end_time(segment), graph.segments[segment].end)

    def state_at(self, segment: int, t: float, contact: int | None = None) -> LinearState:
        """Return place, velocity and slip (6,) at a time (s), which is that of a contact or certain."""
        return LinearState(*evaluate_segment_state(self.solution, segment, t, contact))

    def end_time(self, segment: int) -> float:
        """Return the end of a segment, s; every ball rests by `LONGEST_MOTION`."""
        graph = self.solution.graph
        return min(graph.end_time(segment), graph.start_time(segment) + LONGEST_MOTION)

    def strike_sigma(self, segment: int) -> float:
        """Return the standard deviation, s, of the time of the contact that begins a segment; 0 where none does."""
        graph = self.solution.graph
        start = graph.segments[segment].start
        return 0.0 if start is None else self._parameter_sigma(layout_parameters(graph).contact + start)

    @property
    def rolling_friction(self) -> tuple[float, float]:
        """Rolling friction of the cloth, and the standard deviation of its logarithm."""
        shared = layout_parameters(self.solution.graph).shared
        return self.solution.friction.rolling, self._parameter_sigma(shared + 1)

    @property
    def friction(self) -> tuple[float, float]:
        """Sliding friction of the cloth, and the standard deviation of its logarithm."""
        shared = layout_parameters(self.solution.graph).shared
        return self.solution.friction.sliding, self._parameter_sigma(shared)

    def evaluate(
        self, function: Callable[[FloatArray], FloatArray], *states: LinearState
    ) -> tuple[FloatArray, FloatArray]:
        """Evaluate functions of states.

        Args:
            function: Maps the joined values (K,) to numbers (M,).

        Returns:
            The numbers (M,), and their standard deviations by linear propagation of the covariance.
        """
        value = np.concatenate([one.value for one in states])
        steps = _STEP * np.eye(len(value))
        slope = np.stack([(function(value + one) - function(value - one)) / (2 * _STEP) for one in steps], axis=1)
        gradients = slope @ np.vstack([one.jacobian for one in states])
        return function(value), np.array([self.sigma_of(one) for one in gradients])

    def sigma_of(self, gradient: FloatArray) -> float:
        """Return the standard deviation of a number with a gradient (P,)."""
        return float(np.sqrt(max(float(gradient @ self.covariance @ gradient), 0.0)))

    def _parameter_sigma(self, number: int) -> float:
        """Return the standard deviation of one packed parameter."""
        return float(np.sqrt(max(float(self.covariance[number, number]), 0.0)))


def turn_angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle, degrees, from vector a to vector b; > 0 turns x towards y, to the right of the player."""
    return float(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))
