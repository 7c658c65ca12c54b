"""Robust scales: standard deviations that ignore single outliers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

# Standard deviation over the median absolute deviation, normal distribution.
MAD_TO_SIGMA = 1.4826
# Median of the norm of a two-dimensional standard normal vector.
NORM_MEDIAN = 1.1774


def estimate_sigma(values: NDArray[np.floating[Any]], centre: float | None = None) -> float:
    """Estimate a standard deviation by the median absolute deviation: half of the values may be outliers.

    Args:
        values: (N, ...) values.
        centre: Value about which they scatter; the median along the first axis if None.

    Returns:
        The standard deviation of one value; NaN of none.
    """
    middle = np.median(values, axis=0) if centre is None else centre
    return float(MAD_TO_SIGMA * np.median(np.abs(values - middle)))


def estimate_norm_sigma(norms: FloatArray) -> float:
    """Estimate the standard deviation of either coordinate from the norms (N,) of pairs."""
    return float(np.median(norms)) / NORM_MEDIAN
