"""A patch that brakes is located and measured; none is reported where the motion is the same everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.unexplained.force_law import ExcessAcceleration
from diagnosis.unexplained.local_patch import find_local_patch

PIECES, SHOTS, SIGMA = 300, 12, 0.05
CENTRE, RADIUS, STRENGTH = np.array([1.3, 0.4]), 0.25, -0.4


def pieces(strength: float, seed: int) -> ExcessAcceleration:
    """Draw pieces of motion on a table of 2 x 1 m, some of them braked within a disc."""
    rng = np.random.default_rng(seed)
    heading, speed = rng.uniform(0, 2 * np.pi, PIECES), rng.uniform(0.2, 3.0, PIECES)
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = rng.uniform(0, 1, (PIECES, 2)) * [2.0, 1.0]
    inside = np.linalg.norm(place - CENTRE, axis=1) < RADIUS
    values = (strength * inside)[:, None] * along + SIGMA * rng.standard_normal((PIECES, 2))
    shot = rng.integers(0, SHOTS, PIECES)
    return ExcessAcceleration(values, np.full(PIECES, SIGMA), shot, np.zeros(PIECES), place, speed[:, None] * along)


@pytest.mark.parametrize("seed", range(4))
def test_a_patch_is_located_and_measured(seed: int) -> None:
    patch = find_local_patch(pieces(STRENGTH, seed), np.random.default_rng(seed))
    assert patch is not None
    assert np.linalg.norm(patch.centre - CENTRE) < 0.08
    assert patch.radius == pytest.approx(RADIUS, rel=0.4)
    assert patch.strength == pytest.approx(STRENGTH, rel=0.2)
    assert patch.strength_sigma < 0.1
    assert patch.p_value <= 0.005


def test_motion_that_is_alike_everywhere_has_no_patch() -> None:
    drawn = [find_local_patch(pieces(0.0, seed), np.random.default_rng(seed)) for seed in range(20)]
    assert sum(one is not None for one in drawn) <= 1
