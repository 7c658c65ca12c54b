"""Maxima along a profile, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import find_peaks

from video.table_edges import peaks


@pytest.mark.parametrize("seed", range(40))
def test_maxima_and_their_prominence_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = np.convolve(rng.normal(size=300), np.ones(seed % 5 + 1), "same")
    levels = np.round(levels, 1) if seed % 2 else levels  # with plateaus
    index, prominence = peaks(levels, 0.4, 0.2)
    expected, properties = find_peaks(levels, height=0.4, prominence=0.2)
    assert len(expected) > 5
    np.testing.assert_array_equal(index, expected)
    np.testing.assert_allclose(prominence, properties["prominences"])


@pytest.mark.parametrize("levels", [[1.0], [1.0, 1.0], [0.0, 1.0], [3.0, 2.0, 3.0], [2.0] * 9])
def test_what_has_no_maximum_inside_gives_none(levels: list[float]) -> None:
    index, prominence = peaks(np.array(levels), 0.0, 0.0)
    assert len(index) == len(prominence) == 0
