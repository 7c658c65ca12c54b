"""What is drawn about a fit scatters as the fit leaves it open."""

from __future__ import annotations

import numpy as np
from support.bouncing_ball import filmed

from models.estimation.multiple_shooting.posterior_samples import drawn
from models.estimation.multiple_shooting.shooting_fit import shoot


def test_draws_scatter_as_the_fit_says() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    found = shoot(model)
    draws = drawn(model, found.starts, found.shared, 4000, 1.0, np.random.default_rng(0))
    starts, shared = np.array([one[0][0] for one in draws]), np.array([one[1] for one in draws])
    np.testing.assert_allclose(starts.mean(axis=0), found.starts[0], atol=4e-3)
    expected = np.sqrt(np.diag(found.start_covariances[0]) / found.inflation)
    np.testing.assert_allclose(starts.std(axis=0), expected, rtol=0.1)
    np.testing.assert_allclose(shared.std(axis=0), found.sigma / np.sqrt(found.inflation), rtol=0.1)


def test_wider_draws_scatter_more() -> None:
    model = filmed(np.random.default_rng(3), 1, 0.004)
    found = shoot(model)
    one, two = (
        np.array(
            [d[1] - found.shared for d in drawn(model, found.starts, found.shared, 50, w, np.random.default_rng(1))]
        )
        for w in (1.0, 2.0)
    )
    np.testing.assert_allclose(two[:, 0], 2 * one[:, 0], rtol=0.02)
