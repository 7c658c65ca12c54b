"""Noise estimates whose correlation is given."""

from __future__ import annotations

import numpy as np

from diagnosis.fitting.shot_preparation import CorrelationEstimate, NoiseEstimate

_BORDERS = np.array([0.0, 0.97])


def assume_correlation(value: float, sigma: float = 0.06) -> NoiseEstimate:
    """Return an estimate of noise of the stated size, with a correlation and its error."""
    estimate = CorrelationEstimate(value, sigma, _BORDERS, _BORDERS) if value else None
    return NoiseEstimate(1.0, estimate, 100)
