"""Samples that no ball can have are found by their neighbours; contacts are never outliers."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.tracking.track_noise import find_outliers

T = np.arange(12) / 30
SIGMA = np.full(12, 1e-3)


def along(x: list[float]) -> FloatArray:
    """Places (12, 2) on a line, m."""
    return np.stack([np.array(x), np.full(12, 0.4)], axis=1)


ROLLING = [0.02 * k for k in range(12)]
STRUCK = [0.5] * 6 + [0.5 + 0.1 * k for k in range(6)]
REBOUND = [0.1 * abs(k - 6) for k in range(12)]
STOPPED = [0.1 * min(k, 6) for k in range(12)]


@pytest.mark.parametrize("path", [ROLLING, STRUCK, REBOUND, STOPPED])
def test_no_contact_is_an_outlier(path: list[float]) -> None:
    assert not find_outliers(T, along(path), SIGMA).any()


@pytest.mark.parametrize(("path", "row"), [(ROLLING, 5), (STRUCK, 5), (STRUCK, 4), (STOPPED, 7)])
def test_a_sample_elsewhere_is_one_and_its_neighbours_are_none(path: list[float], row: int) -> None:
    xy = along(path)
    xy[row] += [-0.01, 0.04]
    assert np.flatnonzero(find_outliers(T, xy, SIGMA)).tolist() == [row]
