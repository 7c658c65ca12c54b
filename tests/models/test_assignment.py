"""Assignments cost the least, and are those of an independent implementation also where several cost the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from models.numerics.assignment import assigned


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (5, 9), (9, 5), (16, 32), (0, 3), (3, 0)])
@pytest.mark.parametrize("whole", [False, True])
def test_assignments_are_those_of_scipy(shape: tuple[int, int], whole: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        cost = rng.integers(-3, 4, shape).astype(np.float64) if whole else rng.normal(size=shape)
        cost[rng.random(shape) < 0.2] = 1e6
        found, expected = assigned(cost), linear_sum_assignment(cost)
        assert np.array_equal(found[0], expected[0])
        assert np.array_equal(found[1], expected[1])


def test_equal_costs_give_the_diagonal() -> None:
    rows, columns = assigned(np.ones((4, 6)))
    assert rows.tolist() == columns.tolist() == [0, 1, 2, 3]


def test_what_cannot_be_assigned_is_refused() -> None:
    with pytest.raises(ValueError, match="no assignment"):
        assigned(np.array([[1.0, np.inf], [1.0, np.inf]]))
    with pytest.raises(ValueError, match="numbers"):
        assigned(np.array([[np.nan]]))
