"""Size and correlation of the noise are estimated from recordings alone, whatever moves in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from support.pucks import Filming, film

from diagnosis.fitting.shot_preparation import apply_noise_estimate, estimate_noise
from models.core.recording import Recording, record_points

GLIDING = {"friction.mu": 0.02, "air_drag.k": 0.1}


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_size_and_correlation_of_noise_are_found(correlation: float) -> None:
    estimates = [
        estimate_noise(film(np.random.default_rng(seed), GLIDING, Filming(correlation=correlation)))
        for seed in range(6)
    ]
    assert abs(np.mean([one.scale for one in estimates]) / 0.001 - 1) < 0.08
    assert abs(np.mean([one.correlation for one in estimates]) - correlation) < 0.08


@pytest.mark.parametrize("correlation", [0.5, 0.8, 0.9])
def test_an_estimated_correlation_states_its_error(correlation: float) -> None:
    """Chance alone gives 0.35 to 0.65 for 0.5 in a few short shots, and more below than above 0.9."""
    filming, rng = Filming(shots=2, seconds=1.0, correlation=correlation), np.random.default_rng(0)
    found = [estimate_noise(film(np.random.default_rng(seed), GLIDING, filming)) for seed in range(24)]
    drawn = [one.correlation_estimate.draw(400, rng) for one in found if one.correlation_estimate is not None]
    assert len(drawn) > 18
    below = np.array([(correlations < correlation).mean() for correlations in drawn])
    off = norm.ppf(np.clip(below, 0.001, 0.999))
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5
    assert np.median([correlations.std() for correlations in drawn]) > 0.05


def test_white_noise_is_seldom_called_correlated() -> None:
    filming = Filming(shots=4, seconds=1.0)
    called = [estimate_noise(film(np.random.default_rng(s), GLIDING, filming)).correlation > 0 for s in range(20)]
    assert sum(called) <= 3


def throw(seed: int, steps: str, stamps: str = "exact", noise: float = 0.002) -> tuple[Recording, ...]:
    """Six throws of a ball seen 90 times: evenly, up to half a frame off, at random, or by two cameras of their own."""
    rng, shots = np.random.default_rng(seed), []
    for shot in range(6):
        clocks = [np.arange(90) / 60]
        if steps == "uneven":
            clocks = [(np.arange(90) + rng.uniform(-0.49, 0.49, 90)) / 60]
        elif steps == "random":
            clocks = [np.cumsum(rng.exponential(1 / 60, 90))]
        elif steps == "two cameras":
            clocks.append(np.arange(90) / 50 + 0.003)
        t = np.unique(np.concatenate(clocks))
        positions = np.full((len(t), len(clocks), 2), np.nan)
        v_x, v_z = rng.uniform(2, 6), rng.uniform(4, 7)
        for body, clock in enumerate(clocks):
            path = np.stack([v_x * clock, v_z * clock - 4.905 * clock**2], axis=1)
            positions[np.searchsorted(t, clock), body] = path + rng.normal(0, noise, (90, 2))
        shown = np.round(t, 3) if stamps == "milliseconds" else t
        shots.append(replace(record_points(shown, positions, shot=shot), sigma=np.full(positions.shape[:2], 0.001)))
    return tuple(shots)


@pytest.mark.parametrize("steps", ["even", "uneven", "random", "two cameras"])
def test_noise_is_estimated_at_the_times_of_samples(steps: str) -> None:
    """In the numbers of the samples it would be 15 to 60 times too large, and with two cameras not measured."""
    estimates = [estimate_noise(throw(seed, steps)) for seed in range(3)]
    assert all(one.is_measured and abs(one.scale / 2.0 - 1) < 0.06 and one.correlation == 0 for one in estimates)


def test_times_that_are_rounded_to_milliseconds_add_no_noise() -> None:
    assert abs(estimate_noise(throw(0, "even", "milliseconds", noise=0.0005)).scale / 0.5 - 1) < 0.06


def test_a_missing_frame_parts_segments() -> None:
    """Runs of 20 frames between gaps hold no segment of 21; a larger step than 1.9 counts as a gap."""

    def estimate(missing: int) -> int:
        blank = ((np.arange(90) + 1) % missing == 0)[:, None, None]
        shots = (replace(one, positions=np.where(blank, np.nan, one.positions)) for one in throw(0, "even"))
        return estimate_noise(tuple(shots)).segment_count

    assert estimate(21) == 0
    assert estimate(30) > 8


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


def turn(rng: np.random.Generator, step: float, noise: float) -> tuple[Recording, ...]:
    """Six runs of an arm that turns to and fro within a segment, with an encoder of these steps."""
    t, shots = np.arange(150) / 50, []
    for shot in range(6):
        waves = (0.3 * np.sin(2 * np.pi * rate * t + rng.uniform(0, 6)) for rate in rng.uniform(2, 4, 3))
        seen = sum(waves, rng.normal(0, noise, len(t)))
        seen = np.round(seen / step) * step
        shots.append(replace(record_points(t, seen[:, None, None], shot=shot), sigma=np.full((len(t), 1), 0.001)))
    return tuple(shots)


@pytest.mark.parametrize(("step", "noise"), [(1e-6, 0.004), (0.012, 0.0)])
def test_a_motion_faster_than_a_segment_is_no_correlated_noise(step: float, noise: float) -> None:
    """What a polynomial of 21 samples misses of it would be noise of 90 mrad with a correlation of 0.95."""
    estimate = estimate_noise(turn(np.random.default_rng(0), step, noise))
    assert abs(estimate.scale / (1000 * np.hypot(noise, step / np.sqrt(12))) - 1) < 0.25
    assert estimate.correlation == 0


@pytest.mark.parametrize("correlation", [0.85, 0.95])
def test_strongly_correlated_noise_stays_noise(correlation: float) -> None:
    noise = estimate_noise(film(np.random.default_rng(0), GLIDING, Filming(correlation=correlation)))
    assert noise.correlation > 0.65
