"""Scatter of estimates of one strength about their mean: Cochran's test, and the variance beyond their errors.

The variance is that of DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import ShotInformation
from models.core.typing import FloatArray

# Information of a shot over that of the best one, below which it says nothing of a strength.
_MIN_INFORMATION = 1e-6


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of estimates about their mean."""

    mean: float
    square: float
    """Sum of the squared deviations from the mean, in squared errors."""
    freedom: int
    """Number of estimates less 1."""
    scale: float
    """What one unit of variance between the estimates adds to `square` on average."""

    @property
    def p_value(self) -> float:
        """Probability of such a scatter where the estimates differ by their errors alone."""
        return float(chi2.sf(self.square, self.freedom))

    @property
    def variance(self) -> float:
        """Variance of the strength beyond the errors; negative by chance where there is none."""
        return (self.square - self.freedom) / self.scale


def measure_scatter(values: FloatArray, weights: FloatArray) -> Scatter:
    """Measure the scatter of estimates.

    Args:
        values: (N,) estimates.
        weights: (N,) inverse squares of their errors.

    Returns:
        The scatter.
    """
    total = float(weights.sum())
    mean = float(weights @ values) / total
    square = float(weights @ np.square(values - mean))
    return Scatter(mean, square, len(values) - 1, total - float(np.square(weights).sum()) / total)


def estimate_shot_steps(
    shot_information: ShotInformation, parameter: int, lack_of_fit: float
) -> tuple[FloatArray, FloatArray]:
    """Estimate by how much each shot alone would change a fitted strength, by its gradient near the fit.

    Args:
        shot_information: Information of each shot.
        parameter: Index of the strength.
        lack_of_fit: Factor by which the variance of the residuals exceeds that of the noise.

    Returns:
        (N,) steps and (N,) their weights, of the shots that say something of the strength.
    """
    information = shot_information.information[:, parameter, parameter]
    usable = information > _MIN_INFORMATION * information.max(initial=0.0)
    return shot_information.score[usable, parameter] / information[usable], information[usable] / lack_of_fit
