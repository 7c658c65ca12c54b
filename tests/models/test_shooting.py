"""Multiple shooting on a ball that bounces: true numbers within honest errors, whatever the first guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bouncing_ball import NOTHING, Bounces, filmed, flight

from models.estimation.multiple_shooting.lack_of_fit import correlation_factor
from models.estimation.multiple_shooting.shooting_fit import Shooting, parameters_of, priors_of, shoot
from models.estimation.multiple_shooting.shooting_windows import SENSITIVE, Flow, Window, sensitive_from
from models.physics.effect import Prior

TRUTH = np.array([9.81, 0.8])


def cut(model: Bounces, at: float) -> Bounces:
    """The same drops, each in two windows tied together."""
    windows, heights, ends = [], [], []
    for window, seen, end in zip(model.windows, model.heights, model.ends, strict=True):
        early = window.t <= at
        guess = np.array([seen[~early][0], 0.0])
        for part, start, link in ((early, window.start, None), (~early, guess, np.full(2, 1e-4))):
            offset = 0.0 if link is None else at
            windows.append(replace(window, t=window.t[part] - offset, body=window.body[part], start=start, link=link))
            heights.append(seen[part])
            ends.append(at if link is None else end - at)
    return replace(model, windows=tuple(windows), heights=tuple(heights), ends=tuple(ends))


def test_without_noise_the_truth_is_found() -> None:
    model = replace(filmed(np.random.default_rng(1), 3, 1e-9), sigma=1e-4)
    assert np.allclose(shoot(model).shared, TRUTH, rtol=1e-4)


def test_errors_are_as_large_as_promised() -> None:
    pulls = []
    for seed in range(40):
        found = shoot(filmed(np.random.default_rng(seed), 2, 0.004))
        pulls.append((found.shared - TRUTH) / found.sigma)
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((spread > 0.7) & (spread < 1.3)), spread


def test_errors_of_states_are_as_large_as_promised() -> None:
    pulls = []
    for seed in range(40):
        model = filmed(np.random.default_rng(seed), 2, 0.004, guess=0.0)
        found = shoot(model)
        for window, start, covariance in zip(model.windows, found.starts, found.start_covariances, strict=True):
            pulls.append((start - window.start) / np.sqrt(np.diag(covariance)))
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.25


def test_correlated_noise_widens_errors_until_they_are_honest() -> None:
    pulls, naive = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model = filmed(rng, 2, 0.0)
        seen = []
        for heights in model.heights:
            noise = np.zeros(len(heights))
            for k in range(1, len(noise)):
                noise[k] = 0.8 * noise[k - 1] + 0.0024 * rng.standard_normal()
            seen.append(heights + noise)
        found = shoot(replace(model, heights=tuple(seen), sigma=0.004))
        pulls.append((found.shared - TRUTH) / found.sigma)
        naive.append(pulls[-1] * np.sqrt(found.inflation))
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4
    assert np.sqrt(np.mean(np.square(naive))) > 1.6


def test_a_start_with_the_wrong_number_of_bounces_recovers() -> None:
    recovered = 0
    for seed in range(12):
        model = filmed(np.random.default_rng(seed), 1, 0.002)
        wrong = np.array([0.3, -1.0])
        orders = [flight(start, 9.0, 0.7, model.windows[0].t, 1.5)[2] for start in (wrong, model.windows[0].start)]
        assert orders[0] != orders[1]
        found = shoot(replace(model, windows=(replace(model.windows[0], start=wrong),)))
        recovered += bool(np.all(np.abs(found.shared - TRUTH) < 5 * found.sigma)) and found.chi2_per_dof < 2
    assert recovered >= 11


def test_windows_that_are_tied_tell_what_one_long_window_tells() -> None:
    model = filmed(np.random.default_rng(5), 2, 0.002)
    whole, parts = shoot(model), shoot(cut(model, 0.7))
    assert np.allclose(whole.shared, parts.shared, atol=0.1 * whole.sigma)
    assert np.allclose(whole.sigma, parts.sigma, rtol=0.1)


def test_free_windows_tell_less_than_tied_ones() -> None:
    tied = cut(filmed(np.random.default_rng(5), 2, 0.002), 0.7)
    loose = replace(tied, windows=tuple(replace(w, link=None, shot=k) for k, w in enumerate(tied.windows)))
    assert np.all(shoot(loose).sigma > shoot(tied).sigma)


def test_a_number_that_acts_on_nothing_is_prior_only() -> None:
    model = filmed(np.random.default_rng(2), 2, 0.002)
    found = shoot(Silent(model))
    assert list(found.prior_only) == [False, False, True]
    assert np.isclose(found.shared[2], NOTHING.value)
    assert np.isclose(found.sigma[2], NOTHING.sigma, rtol=1e-6)


class Silent:
    """Bounces with one more number, which acts on nothing."""

    def __init__(self, model: Bounces) -> None:
        self.model, self.windows = model, model.windows
        self.unknowns = (*model.unknowns, NOTHING)

    def flow(self, window: int, start: NDArray[np.float64], shared: NDArray[np.float64]) -> Flow:
        flow = self.model.flow(window, start, shared[:2])
        return replace(
            flow, by_shared=np.concatenate([flow.by_shared, 0 * flow.by_shared[..., :1]], axis=-1),
            end_by_shared=np.concatenate([flow.end_by_shared, np.zeros((2, 1))], axis=1),
        )  # fmt: skip


def test_outliers_do_not_bend_the_fit() -> None:
    model = filmed(np.random.default_rng(3), 2, 0.002)
    heights = [seen.copy() for seen in model.heights]
    heights[0][10:12] += 0.3
    clean, dirty = shoot(model), shoot(replace(model, heights=tuple(heights)))
    assert np.all(np.abs(dirty.shared - clean.shared) < 3 * clean.sigma)


def test_a_number_does_not_leave_its_bounds() -> None:
    model = filmed(np.random.default_rng(4), 2, 0.002)
    tight = tuple(replace(p, value=min(p.value, 0.75), bounds=(0.0, 0.75)) if p.name == "restitution" else p
                  for p in model.unknowns)  # fmt: skip
    found = shoot(replace(model, unknowns=tight))
    assert found.shared[1] == pytest.approx(0.75)


def test_a_misfit_of_the_law_is_said() -> None:
    model = filmed(np.random.default_rng(6), 2, 0.002)
    heights = tuple(seen + 0.02 * np.sin(9 * np.arange(len(seen)) / 30) for seen in model.heights)
    assert shoot(replace(model, heights=heights)).chi2_per_dof > 4


def test_sensitivity_ends_a_window() -> None:
    slopes = np.exp(np.linspace(0, 5, 51))[:, None, None] * np.eye(2)
    first = sensitive_from(slopes)
    assert np.exp(0.1 * first) > SENSITIVE >= np.exp(0.1 * (first - 1))


def test_independent_residuals_need_no_correlation_factor() -> None:
    rng = np.random.default_rng(7)
    assert correlation_factor([rng.standard_normal((400, 2)) for _ in range(5)]) < 1.2


def test_windows_with_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="one shape"):
        Window(0, np.empty(0), np.empty(0, np.int64), np.zeros(2), np.zeros(3))


def test_a_fit_says_whether_it_converged() -> None:
    found: Shooting = shoot(filmed(np.random.default_rng(8), 2, 0.002))
    assert found.converged
    assert 0.7 < found.chi2_per_dof < 1.3


def test_what_one_fit_found_is_known_to_the_next() -> None:
    model = filmed(np.random.default_rng(9), 2, 0.002)
    found = shoot(model)
    known = priors_of(model.unknowns, found)
    assert np.allclose([prior.value for prior in known], found.shared)
    again = shoot(replace(filmed(np.random.default_rng(10), 2, 0.002), unknowns=known))
    assert np.all(again.sigma < 0.9 * found.sigma)
    told = parameters_of(model.unknowns, found)
    assert [(one.name, one.unit, one.prior_only) for one in told] == [
        ("gravity", "m/s^2", False), ("restitution", "1", False),
    ]  # fmt: skip


def test_starts_sought_anew_are_never_worse_and_find_the_way_from_a_wrong_one() -> None:
    better = 0
    for seed in range(12):
        model = filmed(np.random.default_rng(seed), 1, 0.002, guess=0.0)
        wrong = (np.array([0.3, -1.0]),)
        kept = shoot(model, TRUTH, starts=wrong)
        anew = shoot(model, TRUTH, starts=wrong, anew=True)
        assert anew.cost <= kept.cost + 1e-6
        assert anew.chi2_per_dof < 2
        better += anew.cost < kept.cost - 10
    assert better > 0


def test_a_shot_sought_anew_leaves_the_states_of_others_alone() -> None:
    """What was seen helps the last shot only; of the others it tells nothing."""
    model = filmed(np.random.default_rng(3), 4, 0.002, guess=0.0)
    true = tuple(window.start for window in model.windows)
    blind = tuple(replace(one, start=one.start + np.array([2.0, -12.0])) for one in model.windows[:-1])
    model = replace(model, windows=(*blind, model.windows[-1]), unknowns=tuple(held(one) for one in model.unknowns))
    found = shoot(model, TRUTH, starts=(*true[:-1], np.array([5.0, 30.0])), anew=True)
    assert found.chi2_per_dof < 1.2
    np.testing.assert_allclose(np.array(found.starts), np.array(true), atol=0.02)


def held(prior: Prior) -> Prior:
    """So well known that a fit does not move it."""
    return replace(prior, sigma=1e-9)
