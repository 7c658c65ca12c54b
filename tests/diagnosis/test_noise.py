"""Noise and its correlation come out of recordings alone, whatever moves in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, film

from diagnosis.fitting.noise_estimation import estimate_noise, with_noise

GLIDING = {"friction.mu": 0.02, "air_drag.k": 0.1}


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_size_and_correlation_of_noise_are_found(correlation: float) -> None:
    found = [
        estimate_noise(film(np.random.default_rng(seed), GLIDING, Filming(correlation=correlation)))
        for seed in range(6)
    ]
    assert abs(np.mean([one.scale for one in found]) / 0.001 - 1) < 0.08
    assert abs(np.mean([one.correlation for one in found]) - correlation) < 0.08


def test_white_noise_is_seldom_called_correlated() -> None:
    filming = Filming(shots=4, seconds=1.0)
    called = [estimate_noise(film(np.random.default_rng(s), GLIDING, filming)).correlation > 0 for s in range(20)]
    assert sum(called) <= 3


def test_outliers_are_taken_out_and_do_not_widen_the_noise() -> None:
    clean = film(np.random.default_rng(1), GLIDING)
    rng = np.random.default_rng(2)
    far = [rng.random(one.places.shape[:2]) < 0.01 for one in clean]
    dirty = tuple(
        replace(one, places=one.places + np.where(here[:, :, None], 0.03, 0.0))
        for one, here in zip(clean, far, strict=True)
    )
    noise = estimate_noise(dirty)
    assert abs(noise.scale / 0.001 - 1) < 0.1
    kept = [one.seen for one in with_noise(dirty, noise)]
    found = sum(int((here & ~seen).sum()) for here, seen in zip(far, kept, strict=True))
    wrong = sum(int((~here & ~seen).sum()) for here, seen in zip(far, kept, strict=True))
    assert found >= 0.8 * sum(int(here.sum()) for here in far)
    assert wrong <= 0.002 * sum(here.size for here in far)


def test_a_kink_in_a_path_is_no_outlier() -> None:
    one = film(np.random.default_rng(3), GLIDING, Filming(shots=1))[0]
    bent = one.places.copy()
    bent[45:, :, 0] += 1.5 * (one.t[45:] - one.t[45])[:, None]
    noisy = with_noise((replace(one, places=bent),), estimate_noise((one,)))
    assert noisy[0].seen.all()
