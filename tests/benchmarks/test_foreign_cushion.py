"""The invented cushion of `real_tables` is possible: symmetric, without gain of energy, and of no published form."""

from __future__ import annotations

import numpy as np

from benchmarks.table_cases.foreign_cushion import rebound_from_pad
from models.physics.billiards.ball_cushion.rebound_correction import rebound_energy


def test_a_pad_is_symmetric_and_creates_no_energy() -> None:
    rng = np.random.default_rng(1)
    before = np.column_stack([rng.uniform(0.1, 4.0, 300), rng.normal(size=(300, 4)) * [1.5, 1.0, 1.0, 1.0]])
    after = rebound_from_pad(before)
    assert np.all(after[:, 0] < 0)
    energy = [[rebound_energy(*row) for row in states] for states in (before, after)]
    assert np.all(np.array(energy[1]) <= energy[0])
    mirror = np.array([1.0, -1.0, 1.0, -1.0, -1.0])
    np.testing.assert_allclose(rebound_from_pad(before * mirror), after * mirror, atol=1e-9)


def test_its_restitution_depends_on_more_than_the_speed_into_it() -> None:
    """Published models with a power law depend on the speed into the cushion; here the slip counts too."""
    straight, slipping = rebound_from_pad(np.array([[1.0, 0, 1.0, 0, 0], [1.0, 2.0, 1.0, 2.0, 0]]))
    fast, slow = rebound_from_pad(np.array([[3.0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0]]))
    assert abs(straight[0] - slipping[0]) > 5e-3
    assert slow[0] / 0.3 - fast[0] / 3.0 < -0.04
