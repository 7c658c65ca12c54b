"""Increase of the uncertainty of a fit by residuals that are too large, or correlated in time."""

from __future__ import annotations

from models.core.typing import FloatArray

# Residuals below which a series contains no usable autocorrelation.
_MIN_SERIES_LENGTH = 4


def measure_lack_of_fit(series: list[FloatArray], free: int) -> tuple[float, float]:
    """Measure by how much residuals exceed their nominal errors.

    Args:
        series: Residuals (K, d) of each body in standard deviations, bounded by a robust loss, in the order of time.
        free: Number of fitted parameters.

    Returns:
        chi2 per degree of freedom, and the factor on variances that it and correlations in time require, at least 1;
        NaN and 1 without a degree of freedom.
    """
    count = sum(one.size for one in series)
    if count <= free:
        return float("nan"), 1.0
    chi2 = sum(float((one**2).sum()) for one in series) / (count - free)
    return chi2, max(1.0, chi2 * correlation_factor(series))


def correlation_factor(series: list[FloatArray]) -> float:
    """Estimate the factor by which correlation increases the variance of a mean of residuals, at least 1.

    The factor is 1 + 2 (rho_1 + rho_2 + ...). Autocorrelations are pooled over all series and added in pairs until a
    pair is negative (Geyer 1992, initial positive sequence, doi:10.1214/ss/1177011137).

    Args:
        series: Residuals (K, d) of each body, in the order of time.

    Returns:
        Variance factor with respect to independent residuals.
    """
    long = [one for one in series if len(one) >= _MIN_SERIES_LENGTH]
    variance = _mean_autocovariance(long, 0)
    if not long or variance <= 0:
        return 1.0
    total, lag, longest = 0.0, 1, max(len(one) for one in long)
    while lag + 1 < longest:
        pair = _mean_autocovariance(long, lag) + _mean_autocovariance(long, lag + 1)
        if pair <= 0:
            break
        total, lag = total + pair / variance, lag + 2
    return max(1.0, 1 + 2 * total)


def _mean_autocovariance(series: list[FloatArray], lag: int) -> float:
    """Average the products of residuals that are `lag` apart, over all series."""
    products = [float((one[lag:] * one[: len(one) - lag]).sum()) for one in series if len(one) > lag]
    count = sum(one[lag:].size for one in series if len(one) > lag)
    return sum(products) / count if count else 0.0
