"""A short formula of the restitution, where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from models.estimation.table_learning.learned_table import (
    DEFAULT_SCATTER,
    LearnedTable,
    fit_restitution_formula,
    rebound_rolling_balls,
)
from models.physics.billiards.ball_cushion.rebound_correction import HIDDEN, INPUTS, NO_CORRECTION, WEIGHT_COUNT
from models.physics.billiards.parameter_vector import CUSHION_E, CUSHION_E_POWER, neutral_parameters

R, M = 0.03, 0.2


def make_table(correction: np.ndarray = NO_CORRECTION) -> LearnedTable:
    physics = neutral_parameters()
    physics[[CUSHION_E, CUSHION_E_POWER]] = 0.8, 0.1
    return LearnedTable(
        "mirror", physics, DEFAULT_SCATTER, np.zeros(4), 1e-6 * np.eye(4), np.empty(0, np.int64), np.empty((0, 0)),
        correction,
    )  # fmt: skip


def test_a_power_law_is_recovered() -> None:
    formula = fit_restitution_formula(make_table(), R, M)
    assert formula.factor == pytest.approx(0.8, abs=1e-6)
    assert formula.power == pytest.approx(0.1, abs=1e-6)
    assert formula.misfit < 1e-9


def test_a_network_that_follows_the_angle_has_no_such_formula() -> None:
    weights = np.zeros(WEIGHT_COUNT)
    weights[0] = 3.0  # the first hidden unit grows with vn over the speed
    weights[HIDDEN * (INPUTS + 1)] = 0.2  # and slows the ball along n
    table = make_table(weights)
    grid = np.full(2, 1.0), np.array([0.0, 60.0]), np.zeros(2)
    plain, corrected = (rebound_rolling_balls(one, *grid, R, M)[:, 0] for one in (make_table(), table))
    assert np.all(corrected > plain)
    assert fit_restitution_formula(table, R, M).misfit > 0.02
