"""The correction of a cushion model keeps the symmetries and the energy of a cushion, whatever its weights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.physics.billiards.ball_cushion.rebound_correction import (
    NO_CORRECTION,
    WEIGHT_COUNT,
    correct_rebound,
    rebound_energy,
)

MIRROR = np.array([1.0, -1.0, 1.0, -1.0, -1.0])
speeds = st.floats(-3.0, 3.0)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 1000), st.floats(0.01, 3.0), speeds, speeds, speeds, speeds)
def test_mirrored_contacts_have_mirrored_corrections_and_no_energy_is_created(
    seed: int, vn: float, vt: float, un: float, ut: float, spin: float
) -> None:
    weights = np.random.default_rng(seed).normal(0, 1.0, WEIGHT_COUNT)
    before = np.array([vn, vt, un, ut, spin])
    model = before * np.array([-0.85, 0.9, 0.3, 0.5, 0.7])
    after, mirrored = model.copy(), model * MIRROR
    correct_rebound(weights, before, after)
    correct_rebound(weights, before * MIRROR, mirrored)
    np.testing.assert_allclose(mirrored, after * MIRROR, atol=1e-12)
    assert after[4] == model[4]
    if not np.array_equal(after, model):
        assert rebound_energy(*after) <= rebound_energy(*before)
        assert after[0] < 0


def test_a_slow_ball_is_hardly_corrected_and_no_weights_change_nothing() -> None:
    weights = np.random.default_rng(1).normal(0, 1.0, WEIGHT_COUNT)
    before = 1e-6 * np.array([1.0, 0.5, 0.2, 0.1, 0.3])
    after = -0.8 * before
    correct_rebound(weights, before, after)
    assert np.abs(after + 0.8 * before).max() < 1e-6
    untouched = after.copy()
    correct_rebound(NO_CORRECTION, before, after)
    np.testing.assert_array_equal(after, untouched)


def test_some_weights_do_correct() -> None:
    before = np.array([1.0, 0.4, 0.0, 0.0, 0.2])
    after = np.array([-0.8, 0.35, -1.0, 0.3, 0.1])
    corrected = after.copy()
    correct_rebound(0.3 * np.ones(WEIGHT_COUNT), before, corrected)
    assert np.abs(corrected - after).max() == pytest.approx(0.3, abs=0.2)
