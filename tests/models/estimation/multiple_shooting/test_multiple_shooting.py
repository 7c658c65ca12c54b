"""Multiple shooting on a bouncing ball: true parameters within their errors, from any initial guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bouncing_ball import NOTHING, Bounces, filmed, flight

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import (
    ShootingFit,
    convert_to_priors,
    fit_windows,
    summarize_parameters,
)
from models.estimation.multiple_shooting.shooting_windows import (
    MAX_SENSITIVITY,
    LinearizedWindow,
    Window,
    find_sensitive_observation,
    fix_parameters,
)
from models.numerics.statistics import correlation_factor
from models.physics.effect import Prior

TRUTH = np.array([9.81, 0.8])


def split_windows(model: Bounces, at: float) -> Bounces:
    """Split each drop into two linked windows."""
    windows, heights, ends = [], [], []
    for window, observed, end in zip(model.windows, model.heights, model.ends, strict=True):
        early = window.t <= at
        guess = np.array([observed[~early][0], 0.0])
        for part, start, link in ((early, window.start, None), (~early, guess, np.full(2, 1e-4))):
            offset = 0.0 if link is None else at
            windows.append(
                replace(window, t=window.t[part] - offset, body=window.body[part], start=start, link_sigma=link)
            )
            heights.append(observed[part])
            ends.append(at if link is None else end - at)
    return replace(model, windows=tuple(windows), heights=tuple(heights), ends=tuple(ends))


def test_without_noise_the_truth_is_found() -> None:
    model = replace(filmed(np.random.default_rng(1), 3, 1e-9), sigma=1e-4)
    assert np.allclose(fit_windows(model).shared, TRUTH, rtol=1e-4)


def test_errors_of_parameters_and_states_match_their_standard_deviations() -> None:
    pulls, pulls_of_states = [], []
    for seed in range(40):
        result = fit_windows(filmed(np.random.default_rng(seed), 2, 0.004))
        pulls.append((result.shared - TRUTH) / result.sigma)
        true = filmed(np.random.default_rng(seed), 2, 0.004, guess=0.0).windows
        for window, start, covariance in zip(true, result.starts, result.start_covariances, strict=True):
            pulls_of_states.append((start - window.start) / np.sqrt(np.diag(covariance)))
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((spread > 0.7) & (spread < 1.3)), spread
    assert 0.75 < np.sqrt(np.mean(np.square(pulls_of_states))) < 1.25


def test_correlated_noise_increases_standard_deviations_enough() -> None:
    pulls, naive = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        model = filmed(rng, 2, 0.0)
        observed = []
        for heights in model.heights:
            noise = np.zeros(len(heights))
            for k in range(1, len(noise)):
                noise[k] = 0.8 * noise[k - 1] + 0.0024 * rng.standard_normal()
            observed.append(heights + noise)
        result = fit_windows(replace(model, heights=tuple(observed), sigma=0.004))
        pulls.append((result.shared - TRUTH) / result.sigma)
        naive.append(pulls[-1] * np.sqrt(result.inflation))
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4
    assert np.sqrt(np.mean(np.square(naive))) > 1.6


def test_a_start_with_the_wrong_number_of_bounces_recovers() -> None:
    recovered = 0
    for seed in range(12):
        model = filmed(np.random.default_rng(seed), 1, 0.002)
        wrong = np.array([0.3, -1.0])
        orders = [flight(start, 9.0, 0.7, model.windows[0].t, 1.5)[2] for start in (wrong, model.windows[0].start)]
        assert orders[0] != orders[1]
        result = fit_windows(replace(model, windows=(replace(model.windows[0], start=wrong),)))
        recovered += bool(np.all(np.abs(result.shared - TRUTH) < 5 * result.sigma)) and result.chi2_per_dof < 2
    assert recovered >= 11


def test_linked_windows_constrain_as_much_as_one_long_window() -> None:
    model = filmed(np.random.default_rng(5), 2, 0.002)
    whole, parts = fit_windows(model), fit_windows(split_windows(model, 0.7))
    assert np.allclose(whole.shared, parts.shared, atol=0.1 * whole.sigma)
    assert np.allclose(whole.sigma, parts.sigma, rtol=0.1)


def test_free_windows_constrain_less_than_linked_ones() -> None:
    tied = split_windows(filmed(np.random.default_rng(5), 2, 0.002), 0.7)
    loose = replace(tied, windows=tuple(replace(w, link_sigma=None, shot=k) for k, w in enumerate(tied.windows)))
    assert np.all(fit_windows(loose).sigma > fit_windows(tied).sigma)


def test_a_parameter_without_effect_is_prior_only() -> None:
    model = filmed(np.random.default_rng(2), 2, 0.002)
    result = fit_windows(Silent(model))
    assert list(result.prior_only) == [False, False, True]
    assert np.isclose(result.shared[2], NOTHING.value)
    assert np.isclose(result.sigma[2], NOTHING.sigma, rtol=1e-6)


class Silent:
    """Bounces with one more parameter, which has no effect."""

    def __init__(self, model: Bounces) -> None:
        self.model, self.windows = model, model.windows
        self.unknowns = (*model.unknowns, NOTHING)

    def linearize(self, window: int, start: NDArray[np.float64], shared: NDArray[np.float64]) -> LinearizedWindow:
        flow = self.model.linearize(window, start, shared[:2])
        return replace(
            flow, shared_jacobian=np.concatenate([flow.shared_jacobian, 0 * flow.shared_jacobian[..., :1]], axis=-1),
            end_shared_jacobian=np.concatenate([flow.end_shared_jacobian, np.zeros((2, 1))], axis=1),
        )  # fmt: skip


def test_outliers_do_not_bias_the_fit() -> None:
    model = filmed(np.random.default_rng(3), 2, 0.002)
    heights = [observed.copy() for observed in model.heights]
    heights[0][10:12] += 0.3
    clean, dirty = fit_windows(model), fit_windows(replace(model, heights=tuple(heights)))
    assert np.all(np.abs(dirty.shared - clean.shared) < 3 * clean.sigma)


def test_a_parameter_does_not_leave_its_bounds() -> None:
    model = filmed(np.random.default_rng(4), 2, 0.002)
    tight = tuple(replace(p, value=min(p.value, 0.75), bounds=(0.0, 0.75)) if p.name == "restitution" else p
                  for p in model.unknowns)  # fmt: skip
    result = fit_windows(replace(model, unknowns=tight))
    assert result.shared[1] == pytest.approx(0.75)


def test_a_wrong_model_increases_chi2() -> None:
    model = filmed(np.random.default_rng(6), 2, 0.002)
    heights = tuple(observed + 0.02 * np.sin(9 * np.arange(len(observed)) / 30) for observed in model.heights)
    assert fit_windows(replace(model, heights=heights)).chi2_per_dof > 4


def test_sensitivity_ends_a_window() -> None:
    slopes = np.exp(np.linspace(0, 5, 51))[:, None, None] * np.eye(2)
    first = find_sensitive_observation(slopes)
    assert np.exp(0.1 * first) > MAX_SENSITIVITY >= np.exp(0.1 * (first - 1))


def test_independent_residuals_need_no_correlation_factor() -> None:
    rng = np.random.default_rng(7)
    assert correlation_factor([rng.standard_normal((400, 2)) for _ in range(5)]) < 1.2


def test_windows_with_inconsistent_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="one shape"):
        Window(0, np.empty(0), np.empty(0, np.int64), np.zeros(2), np.zeros(3))


def test_a_fit_reports_whether_it_converged() -> None:
    result: ShootingFit = fit_windows(filmed(np.random.default_rng(8), 2, 0.002))
    assert result.converged
    assert 0.7 < result.chi2_per_dof < 1.3


def test_the_result_of_a_fit_is_the_prior_of_the_next() -> None:
    model = filmed(np.random.default_rng(9), 2, 0.002)
    result = fit_windows(model)
    priors = convert_to_priors(model.unknowns, result)
    assert np.allclose([prior.value for prior in priors], result.shared)
    again = fit_windows(replace(filmed(np.random.default_rng(10), 2, 0.002), unknowns=priors))
    assert np.all(again.sigma < 0.9 * result.sigma)
    fitted = summarize_parameters(model.unknowns, result)
    assert [(one.name, one.unit, one.prior_only) for one in fitted] == [
        ("gravity", "m/s^2", False), ("restitution", "1", False),
    ]  # fmt: skip


def test_retried_guesses_are_never_worse_and_correct_wrong_starts() -> None:
    better = 0
    for seed in range(12):
        model = filmed(np.random.default_rng(seed), 1, 0.002, guess=0.0)
        wrong = (np.array([0.3, -1.0]),)
        selected = fit_windows(model, TRUTH, starts=wrong)
        refitted = fit_windows(model, TRUTH, starts=wrong, retry_guesses=True)
        assert refitted.cost <= selected.cost + 1e-6
        assert refitted.chi2_per_dof < 2
        better += refitted.cost < selected.cost - 10
    assert better > 0


def test_a_refitted_shot_does_not_change_the_states_of_others() -> None:
    """The observations constrain the last shot only, not the others."""
    model = filmed(np.random.default_rng(3), 4, 0.002, guess=0.0)
    true = tuple(window.start for window in model.windows)
    blind = tuple(replace(one, start=one.start + np.array([2.0, -12.0])) for one in model.windows[:-1])
    model = replace(
        model, windows=(*blind, model.windows[-1]), unknowns=tuple(tighten_prior(one) for one in model.unknowns)
    )
    result = fit_windows(model, TRUTH, starts=(*true[:-1], np.array([5.0, 30.0])), retry_guesses=True)
    assert result.chi2_per_dof < 1.2
    np.testing.assert_allclose(np.array(result.starts), np.array(true), atol=0.02)


def tighten_prior(prior: Prior) -> Prior:
    """Return a prior so narrow that a fit does not move it."""
    return replace(prior, sigma=1e-9)


@dataclass(frozen=True)
class TogetherBounces(Bounces):
    """The same, simulated several windows at a time; `groups` has their numbers."""

    simulates_together: ClassVar[bool] = True
    groups: ClassVar[list[tuple[int, ...]]] = []

    def simulate_ahead(
        self, windows: Sequence[int], starts: Sequence[FloatArray], shared: Sequence[FloatArray], has_jacobians: bool
    ) -> TogetherBounces:
        self.groups.append(tuple(windows))
        return self


@pytest.mark.parametrize("has_parameters", [True, False])
def test_windows_are_simulated_together_and_fitted_as_each_alone(has_parameters: bool) -> None:
    model = split_windows(filmed(np.random.default_rng(3), 6, 0.002), 0.7)
    own = {one.name: getattr(model, one.name) for one in fields(model)}
    results = []
    TogetherBounces.groups.clear()
    for scene in (Bounces(**own), TogetherBounces(**own)):
        fixed = fix_parameters(scene, TRUTH, np.full(2, has_parameters), scene.unknowns)
        results.append(fit_windows(fixed, TRUTH[: 2 * has_parameters]))
    alone, together = results
    assert np.array_equal(alone.shared, together.shared)
    assert all(map(np.array_equal, alone.starts, together.starts))
    # searches end after different numbers of steps, but most steps of all shots are taken side by side
    assert np.mean([len(one) for one in TogetherBounces.groups]) > len(model.windows) / 3
