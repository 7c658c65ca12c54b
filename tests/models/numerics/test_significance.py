"""Significance of the best of several choices."""

from __future__ import annotations

import numpy as np
import pytest

from models.numerics.statistics import correct_for_choices


def test_the_best_of_many_choices_is_uniform_after_the_correction() -> None:
    best = np.random.default_rng(0).random((4000, 30)).min(axis=1)
    corrected = np.array([correct_for_choices(p, 30) for p in best])
    assert abs(float(np.mean(corrected < 0.05)) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_tiny_and_certain_p_values_keep_their_digits() -> None:
    assert correct_for_choices(1e-30, 12) == pytest.approx(1.2e-29)
    assert correct_for_choices(1.0, 3) == pytest.approx(1.0)
    assert correct_for_choices(0.3, 1) == pytest.approx(0.3)
