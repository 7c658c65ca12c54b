"""Combination of estimates whose errors may be correlated, by covariance intersection (Julier and Uhlmann 1997)."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray

# Tried weights of the first estimate; between two of them the trace hardly changes.
_WEIGHTS = np.linspace(0.0, 1.0, 21)


def intersect_estimates(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Combine two estimates of one vector, whatever the correlation of their errors.

    Unlike inverse-variance weighting it does not claim that an error that both share averages out: two equal estimates
    give their own covariance again.

    Args:
        first: Estimate (n,) and covariance (n, n).
        second: The same.

    Returns:
        The combination of least total variance, and its covariance.
    """
    (x, cov_x), (y, cov_y) = first, second
    info_x, info_y = np.linalg.inv(cov_x), np.linalg.inv(cov_y)
    covariances = [np.linalg.inv(w * info_x + (1 - w) * info_y) for w in _WEIGHTS]
    traces = np.array([np.trace(one) for one in covariances])
    best = _WEIGHTS[traces <= traces.min() * (1 + 1e-9)]
    weight = float(best[np.argmin(np.abs(best - 0.5))])  # of equally good ones the most even
    covariance = np.linalg.inv(weight * info_x + (1 - weight) * info_y)
    return np.asarray(covariance @ (weight * info_x @ x + (1 - weight) * info_y @ y)), np.asarray(covariance)


def measure_contradiction(first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]) -> float:
    """Measure how far two estimates of one vector contradict.

    Args:
        first: Estimate (n,) and covariance (n, n).
        second: The same.

    Returns:
        Probability of a larger difference by independent errors of these covariances.
    """
    from scipy.stats import chi2  # slow to import

    gap, covariance = first[0] - second[0], first[1] + second[1]
    return float(chi2.sf(gap @ np.linalg.solve(covariance, gap), len(gap)))
