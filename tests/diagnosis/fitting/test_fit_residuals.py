"""Residuals of a fit, and what noise would leave in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.noise_estimates import assume_correlation
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.fit_residuals import compute_residuals
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects, linearize_fit
from models.core.typing import FloatArray


def measure_lag(draws: FloatArray) -> FloatArray:
    """Measure the mean product of neighbours in each draw of noise (K, D, N)."""
    return np.asarray((draws[1:] * draws[:-1]).mean(axis=(0, 1)))


def test_an_error_of_the_correlation_is_the_same_in_all_shots() -> None:
    """One sensor took all of them: where its noise is more correlated than estimated, it is so in every shot."""
    shots = film(np.random.default_rng(3), {"friction.mu": 0.02}, Filming(shots=8, fps=60))
    for correlation in (0.0, 0.5):
        problem = build_diagnosis_problem(Pucks(), assume_correlation(correlation))
        fit = fit_effects(problem, tuple(replace(one, shot=k) for k, one in enumerate(shots)))
        residuals = compute_residuals(problem, fit, linearize_fit(problem, fit), np.random.default_rng(0))
        first, second = (measure_lag(residuals.noise_draws[residuals.shot % 2 == k]) for k in (0, 1))
        shared = float(np.corrcoef(first, second)[0, 1])
        assert (shared > 0.3) == (correlation > 0), shared


def test_drawn_noise_is_no_larger_where_its_correlation_is_uncertain() -> None:
    """At 0.9, errors of the correlation alone would double the variance of whitened noise."""
    shots = film(np.random.default_rng(5), {"friction.mu": 0.02}, Filming(shots=2, fps=60))
    for correlation in (0.5, 0.9):
        noise = assume_correlation(correlation, sigma=0.4)
        problem = build_diagnosis_problem(Pucks(), noise)
        fit = fit_effects(problem, shots)
        draws = compute_residuals(problem, fit, linearize_fit(problem, fit), np.random.default_rng(0)).noise_draws
        assert 0.8 < np.square(draws).mean() < 1.1
