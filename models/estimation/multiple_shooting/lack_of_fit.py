"""How much more uncertain a fit is than independent errors of the promised size would make it."""

from __future__ import annotations

from models.core.typing import FloatArray

_SHORT = 4
"""values of a series below which it says nothing about neighbours."""


def correlation_factor(series: list[FloatArray]) -> float:
    """1 + 2 (rho_1 + rho_2 + ...) of residuals (K, d) per body: the factor by which the variance of a mean exceeds
    that of independent residuals; at least 1.

    Autocorrelations are pooled over all series and added in pairs until a pair is negative (Geyer 1992, initial
    positive sequence, doi:10.1214/ss/1177011137).
    """
    long = [one for one in series if len(one) >= _SHORT]
    variance = _autocovariance(long, 0)
    if not long or variance <= 0:
        return 1.0
    total, lag, longest = 0.0, 1, max(len(one) for one in long)
    while lag + 1 < longest:
        pair = _autocovariance(long, lag) + _autocovariance(long, lag + 1)
        if pair <= 0:
            break
        total, lag = total + pair / variance, lag + 2
    return max(1.0, 1 + 2 * total)


def _autocovariance(series: list[FloatArray], lag: int) -> float:
    """Mean product of residuals `lag` apart, over all series."""
    products = [float((one[lag:] * one[: len(one) - lag]).sum()) for one in series if len(one) > lag]
    count = sum(one[lag:].size for one in series if len(one) > lag)
    return sum(products) / count if count else 0.0
