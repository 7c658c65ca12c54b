"""Posterior samples scatter by the uncertainty of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.bouncing_ball import filmed

from models.estimation.multiple_shooting.posterior_samples import GaussianPosterior
from models.estimation.multiple_shooting.shooting_fit import fit_windows


def test_samples_scatter_by_the_covariance_of_the_fit() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    result = fit_windows(model)
    posterior = GaussianPosterior.around_fit(model, result.starts, result.shared, 1.0)
    draws = posterior.sample(4000, np.random.default_rng(0))
    starts, shared = np.array([one[0][0] for one in draws]), np.array([one[1] for one in draws])
    np.testing.assert_allclose(starts.mean(axis=0), result.starts[0], atol=4e-3)
    expected = np.sqrt(np.diag(result.start_covariances[0]) / result.inflation)
    np.testing.assert_allclose(starts.std(axis=0), expected, rtol=0.1)
    np.testing.assert_allclose(shared.std(axis=0), result.sigma / np.sqrt(result.inflation), rtol=0.1)


def test_widened_samples_scatter_more() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    result = fit_windows(model)
    posteriors = (GaussianPosterior.around_fit(model, result.starts, result.shared, w) for w in (1.0, 2.0))
    samples = (one.sample(50, np.random.default_rng(1)) for one in posteriors)
    one, two = (np.array([shared - result.shared for _, shared in drawn]) for drawn in samples)
    np.testing.assert_allclose(two[:, 0], 2 * one[:, 0], rtol=0.02)


def test_slices_sample_the_gaussian_where_the_posterior_is_one() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    result = fit_windows(model)
    posterior = GaussianPosterior.around_fit(model, result.starts, result.shared, 1.0)
    draws = posterior.sample_by_slices(1500, np.random.default_rng(0))
    shared = np.array([one[1] for one in draws])
    np.testing.assert_allclose(shared.std(axis=0), result.sigma / np.sqrt(result.inflation), rtol=0.25)
    np.testing.assert_allclose(shared.mean(axis=0), result.shared, atol=0.3 * result.sigma.max())


def test_slices_stay_where_the_posterior_is_narrower() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    result = fit_windows(model)
    wide = GaussianPosterior.around_fit(model, result.starts, result.shared, 1.0)
    too_wide = replace(wide, information=wide.information / 16.0)
    draws = too_wide.sample_by_slices(1500, np.random.default_rng(0))
    shared = np.array([one[1] for one in draws])
    np.testing.assert_allclose(shared.std(axis=0), result.sigma / np.sqrt(result.inflation), rtol=0.3)
