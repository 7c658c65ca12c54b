"""Size and correlation of the noise are estimated from recordings alone, whatever moves in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, film

from diagnosis.fitting.noise_estimation import apply_noise_estimate, estimate_noise

GLIDING = {"friction.mu": 0.02, "air_drag.k": 0.1}


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_size_and_correlation_of_noise_are_found(correlation: float) -> None:
    estimates = [
        estimate_noise(film(np.random.default_rng(seed), GLIDING, Filming(correlation=correlation)))
        for seed in range(6)
    ]
    assert abs(np.mean([one.scale for one in estimates]) / 0.001 - 1) < 0.08
    assert abs(np.mean([one.correlation for one in estimates]) - correlation) < 0.08


def test_white_noise_is_seldom_called_correlated() -> None:
    filming = Filming(shots=4, seconds=1.0)
    called = [estimate_noise(film(np.random.default_rng(s), GLIDING, filming)).correlation > 0 for s in range(20)]
    assert sum(called) <= 3


def test_outliers_are_taken_out_and_do_not_widen_the_noise() -> None:
    clean = film(np.random.default_rng(1), GLIDING)
    rng = np.random.default_rng(2)
    far = [rng.random(one.positions.shape[:2]) < 0.01 for one in clean]
    dirty = tuple(
        replace(one, positions=one.positions + np.where(here[:, :, None], 0.03, 0.0))
        for one, here in zip(clean, far, strict=True)
    )
    noise = estimate_noise(dirty)
    assert abs(noise.scale / 0.001 - 1) < 0.1
    observed_masks = [one.is_observed for one in apply_noise_estimate(dirty, noise)]
    removed = sum(int((here & ~is_observed).sum()) for here, is_observed in zip(far, observed_masks, strict=True))
    wrong = sum(int((~here & ~is_observed).sum()) for here, is_observed in zip(far, observed_masks, strict=True))
    assert removed >= 0.8 * sum(int(here.sum()) for here in far)
    assert wrong <= 0.002 * sum(here.size for here in far)


def test_a_kink_in_a_path_is_no_outlier() -> None:
    one = film(np.random.default_rng(3), GLIDING, Filming(shots=1))[0]
    bent = one.positions.copy()
    bent[45:, :, 0] += 1.5 * (one.t[45:] - one.t[45])[:, None]
    noisy = apply_noise_estimate((replace(one, positions=bent),), estimate_noise((one,)))
    assert noisy[0].is_observed.all()
