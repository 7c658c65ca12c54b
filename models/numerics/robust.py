"""The robust loss, which bounds single outliers.

Huber's loss (1964, doi:10.1214/aoms/1177703732) is quadratic up to a threshold and linear beyond it; several
coordinates of one observation count by their norm, so that the loss does not depend on the axes.
"""

from __future__ import annotations

import numpy as np

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
