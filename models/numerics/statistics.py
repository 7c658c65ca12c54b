"""Robust loss and scale, combination of estimates, and significance.

Huber's loss (1964, doi:10.1214/aoms/1177703732) is quadratic up to a threshold and linear beyond it; several
coordinates of one observation count by their norm, so that the loss does not depend on the axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.jit import compile_kernel

# Standard deviations at which the loss of an observation turns from quadratic to linear.
HUBER_THRESHOLD = 2.5


def evaluate_huber_loss(residual: FloatArray, threshold: float = HUBER_THRESHOLD) -> tuple[FloatArray, float]:
    """Evaluate Huber's loss of a set of residuals.

    Args:
        residual: (K, d) residuals in standard deviations.
        threshold: Norm at which the loss turns linear.

    Returns:
        Weight (K,) of each observation in a reweighted least-squares step, and the summed cost. Residuals that are not
            finite have weight 0 and infinite cost.
    """
    weight, loss = np.empty(len(residual)), np.empty(len(residual))
    if not _fill_huber_loss(residual, threshold, weight, loss):
        return np.zeros(len(residual)), float("inf")
    return weight, float(loss.sum())


def evaluate_pair_loss(residual: FloatArray, observed: int) -> tuple[FloatArray, float]:
    """Evaluate Huber's loss of pairs of rows, followed by plain squares.

    Args:
        residual: (R,) rows in standard deviations: x and y of every observation in turn, then pseudo-observations.
        observed: Number of rows of observations.

    Returns:
        Weight (R,) of each row, and the summed cost.
    """
    pair_weight, cost = evaluate_huber_loss(residual[:observed].reshape(-1, 2))
    weight = np.ones(len(residual))
    weight[:observed] = np.repeat(pair_weight, 2)
    return weight, float(cost + (residual[observed:] ** 2).sum())


def huber_losses(residual: FloatArray, threshold: float = HUBER_THRESHOLD) -> FloatArray:
    """Return Huber's loss (K,) of each of the residuals (K, d); infinite if any is not finite."""
    weight, loss = np.empty(len(residual)), np.empty(len(residual))
    is_finite = _fill_huber_loss(residual, threshold, weight, loss)
    return loss if is_finite else np.full(len(residual), np.inf)


@compile_kernel
def _fill_huber_loss(residual, threshold, weight, loss):  # type: ignore[no-untyped-def]
    """Fill weight (K,) and loss (K,) of residuals (K, d); return whether all residuals are finite."""
    for k in range(len(residual)):
        square = 0.0
        for one in residual[k]:
            if not np.isfinite(one):
                return False
            square += one * one
        size = np.sqrt(square)
        inner = min(size, threshold)
        weight[k] = threshold / size if size > threshold else 1.0
        loss[k] = 2 * size * inner - inner * inner
    return True


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


def correct_for_choices(p_value: float, count: float) -> float:
    """Return the probability that the best of `count` independent choices is as improbable by chance.

    Args:
        p_value: p-value of the best choice alone.
        count: Number of choices, or of independent ones that they are worth.

    Returns:
        The corrected p-value (Sidak 1967, doi:10.1080/01621459.1967.10482935).
    """
    return -float(np.expm1(count * np.log1p(-min(p_value, 1 - 1e-16))))


# Residuals below which a series contains no usable autocorrelation.
_MIN_SERIES_LENGTH = 4


def measure_lack_of_fit(series: list[FloatArray], free: int) -> tuple[float, float]:
    """Measure by how much residuals exceed their nominal errors.

    Args:
        series: Residuals (K, d) of each body in standard deviations, bounded by a robust loss, in the order of time;
            NaN for no residual.
        free: Number of fitted parameters.

    Returns:
        chi2 per degree of freedom, and the factor on variances that it and correlations in time require, at least 1;
        NaN and 1 without a degree of freedom.
    """
    count = sum(int(np.isfinite(one).sum()) for one in series)
    if count <= free:
        return float("nan"), 1.0
    chi2 = sum(float(np.nansum(one**2)) for one in series) / (count - free)
    return chi2, max(1.0, chi2 * correlation_factor(series))


def correlation_factor(series: list[FloatArray]) -> float:
    """Estimate the factor by which correlation increases the variance of a mean of residuals, at least 1.

    The factor is 1 + 2 (rho_1 + rho_2 + ...). Autocorrelations are pooled over all series and added in pairs until a
    pair is negative (Geyer 1992, initial positive sequence, doi:10.1214/ss/1177011137).

    Args:
        series: Residuals (K, d) of each body, in the order of time; NaN for no residual.

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
    products = [one[lag:] * one[: len(one) - lag] for one in series if len(one) > lag]
    count = sum(int(np.isfinite(one).sum()) for one in products)
    return sum(float(np.nansum(one)) for one in products) / count if count else 0.0
