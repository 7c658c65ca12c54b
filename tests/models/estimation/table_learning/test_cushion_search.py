"""The search for the greatest posterior of a cushion model, where a parameter arrives at its bound."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.table_learning import cushion_learning
from models.estimation.table_learning.cushion_learning import _CushionPosterior
from models.numerics.executor import SERIAL, Executor

# Information of two parameters that depend on each other, and where they would be without bounds and a prior.
INFORMATION, PLACE = np.array([[400.0, 190.0], [190.0, 100.0]]), np.array([2.0, -1.0])
BOUND = 1.0


class Bowl(_CushionPosterior):
    """A posterior whose likelihood is normal, and constant beyond the bounds."""

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.array([-9.0, -9.0]), np.array([BOUND, 9.0])

    def measure_costs(self, points: FloatArray, executor: Executor) -> FloatArray:
        off = np.clip(points, *self.bounds) - PLACE
        return 0.5 * np.sum(points**2, axis=1) + 0.5 * np.einsum("ni,ij,nj->n", off, INFORMATION, off)


def test_the_others_are_searched_with_a_parameter_at_its_bound() -> None:
    posterior = Bowl("mirror", None, 0.03, 0.2, {}, ())  # type: ignore[arg-type]
    curvature = posterior.measure_curvature(np.zeros(2), SERIAL)
    np.testing.assert_allclose(curvature, INFORMATION + np.eye(2), rtol=1e-3)
    best = cushion_learning._search_greatest(posterior, np.zeros(2), curvature, SERIAL)
    assert best[0] == BOUND
    # the minimum over the second parameter with the first at its bound
    expected = (INFORMATION[1] @ PLACE - INFORMATION[1, 0] * BOUND) / (INFORMATION[1, 1] + 1)
    assert abs(best[1] - expected) < 0.05 / np.sqrt(INFORMATION[1, 1])
