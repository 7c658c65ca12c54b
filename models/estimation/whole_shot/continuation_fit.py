"""Continuation fit of one shot: the fitted part of the shot grows contact by contact.

Over a whole shot, the cost has a local minimum for every order of contacts that is nearly right. The shot is therefore
fitted to its first moments, then to a little more than the next contact that this fit predicts, and so on to its end.
Where the newly included observations do not fit, unobserved side spin or a narrowly missed ball is the cause: then
states are drawn from the posterior of the previous fit, and the best of them are followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.posterior_samples import GaussianPosterior
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED, ShootingFit, ShootingOptions, fit_windows
from models.estimation.multiple_shooting.shooting_problem import ShootingProblem, simulate_chains
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.numerics.statistics import huber_losses
from models.physics.billiards.simulation.event_engine import EVENT_TIME
from models.physics.billiards.simulation.parametrised_shot import SIDE_SPIN, start_offsets

Starts = tuple[FloatArray, ...]

# s, duration of the first fit: about a dozen frames of every ball.
FIRST_VIEW = 0.25
# s after a contact that show its outcome.
VIEW_BEYOND_CONTACT = 0.2
# s over which the residuals of one ball are summed for assessment.
ASSESSMENT_TIME = 0.4
# s by which the fitted part grows at least (`MIN_VIEW_STEP`) and at most: unpredicted contacts are included gradually
# too.
MIN_VIEW_STEP, MAX_VIEW_STEP = 0.1, 1.0
_GROWTH_OPTIONS = ShootingOptions(iterations=12)
# Expected cost of an observation of two coordinates with nominal noise.
_EXPECTED_COST = 2.0
# Standard deviations of a sum of costs that count as significant: of all (`_SIGNIFICANT_TOTAL`), of one of many.
_SIGNIFICANT_TOTAL, _SIGNIFICANT_PART = 3.0, 4.5
# Residual over nominal variance of the first fit; a larger ratio is not used as a reference.
_MAX_VARIANCE_RATIO = 2.0
_TRIAL_OPTIONS = ShootingOptions(iterations=3)
# Posterior samples; they take as long as about ten steps of a search.
_SAMPLE_COUNT = 192
# Factor on the posterior standard deviations, because nominal noise may be too small.
_SAMPLE_WIDENING = 1.5
# Standard deviations of the prior between a start and its alternatives.
_PRIOR_STEP = 0.4
# m/s of surface speed, below which reversing the side spin changes nothing.
_NEGLIGIBLE_SIDE_SPIN = 0.05
# Posterior samples of least cost that are refitted (`_REFITTED_SAMPLES`), and of these followed.
_REFITTED_SAMPLES, _FOLLOWED_SAMPLES = 12, 3


@dataclass(frozen=True, slots=True)
class ShotGuess:
    """Start states and shared parameters at one stage of the continuation."""

    starts: Starts
    shared: FloatArray


@dataclass(frozen=True, slots=True)
class UnexplainedView:
    """The first part of a shot that a model does not explain, with the best fit to it."""

    model: ShotWindows
    """Model of this part."""
    guess: ShotGuess
    explained_until: float
    """s, end of the part that is explained."""


def fit_by_continuation(model: ShotWindows, shared: FloatArray, rng: np.random.Generator) -> ShootingFit:
    """Fit one shot to a growing part of its observations.

    Args:
        model: Model of one shot.
        shared: (P,) initial guess of the shared parameters.
        rng: Random generator of the posterior samples.

    Returns:
        The fit to all observations of the shot.
    """
    guess, _ = _extend_view(model, shared, rng, to_the_end=True)
    return _fit_whole_view(model, guess)


def fit_if_explained(model: ShotWindows, shared: FloatArray, rng: np.random.Generator) -> ShootingFit | UnexplainedView:
    """Fit one shot over a growing time span; stop when no posterior sample agrees with the next observations.

    A wrong contact model shows at the first cushion; following it to the end costs more than the whole fit of the right
    one.

    Args:
        model: Model of one shot.
        shared: (P,) initial guess of the shared parameters.
        rng: Random generator of the posterior samples.

    Returns:
        The fit, or the first view that the model does not explain.
    """
    guess, unexplained = _extend_view(model, shared, rng, to_the_end=False)
    return unexplained or _fit_whole_view(model, guess)


def _extend_view(
    model: ShotWindows, shared: FloatArray, rng: np.random.Generator, to_the_end: bool
) -> tuple[ShotGuess, UnexplainedView | None]:
    """Extend the fitted part to all observations; also return the first view that the model does not explain.

    From there, the search goes on without posterior samples, or stops unless `to_the_end`.
    """
    begin, last = float(model.segments[0].t[0]), max(float(segment.t[-1]) for segment in model.segments)
    guess, variance_ratio = _fit_first_view(model, shared)
    viewed, unexplained = begin, None
    while viewed < last:
        view = min(next_view_time(model, guess, viewed), last)
        part, before = model.truncate(view), guess
        guess = _add_new_windows(part, before)
        if not is_explained(part, guess, variance_ratio):
            fitted = fit_windows(part, guess.shared, _GROWTH_OPTIONS, guess.starts)
            if unexplained is None and not is_explained(part, _to_guess(fitted), variance_ratio):
                previous_view = model.truncate(min(max(viewed, begin + FIRST_VIEW), view))
                fitted = _refit_from_samples(previous_view, part, before, fitted, rng)
                if not is_explained(part, _to_guess(fitted), variance_ratio):  # no sample repairs a wrong contact model
                    unexplained = UnexplainedView(part, _to_guess(fitted), viewed)
            guess = _to_guess(fitted)
            if unexplained is not None and not to_the_end:
                break
        viewed = view
    return guess, unexplained


def _fit_whole_view(model: ShotWindows, guess: ShotGuess) -> ShootingFit:
    """Fit all observations of a shot from the last guess and from alternatives to the result."""
    fitted = fit_windows(model, guess.shared, starts=guess.starts)
    alternatives = [
        fit_windows(model, one.shared, _TRIAL_OPTIONS, one.starts) for one in _alternative_guesses(model, fitted)
    ]
    best = min([fitted, *alternatives], key=lambda one: one.cost)
    return fitted if best is fitted else fit_windows(model, best.shared, starts=best.starts)


def _alternative_guesses(model: ShotWindows, fitted: ShootingFit) -> list[ShotGuess]:
    """List starts that a descent does not reach.

    These are steps to both sides along every state that the fit left as uncertain as its prior, because the cloth has
    removed a small side spin before a contact could reveal it; and reversed side spin.
    """
    guesses = []
    for k, (window, covariance) in enumerate(zip(model.windows, fitted.start_covariances, strict=True)):
        start, changes = fitted.starts[k], []
        for j in np.flatnonzero(np.sqrt(np.diag(covariance)) > PRIOR_DOMINATED * window.sigma):
            changes += [(j, start[j] + side * _PRIOR_STEP * window.sigma[j]) for side in (-1, 1)]
        spin = start_offsets(model.segments[k].moving)[:-1][model.segments[k].moving] + SIDE_SPIN
        changes += [(j, -start[j]) for j in spin if abs(start[j]) > _NEGLIGIBLE_SIDE_SPIN]
        for j, value in changes:
            other = start.copy()
            other[j] = value
            guesses.append(ShotGuess((*fitted.starts[:k], other, *fitted.starts[k + 1 :]), fitted.shared))
    return guesses


def next_view_time(model: ShotWindows, guess: ShotGuess, viewed: float) -> float:
    """Compute the time (s) up to which to fit next: past the next predicted contact, or the end of a segment."""
    k = len(guess.starts) - 1
    segment = model.segments[k]
    if viewed >= segment.t[-1]:
        return float(model.segments[k + 1].t[0]) + FIRST_VIEW
    run = model.simulate_possible_run(k, guess.starts[k], guess.shared)
    times = np.array([viewed + MIN_VIEW_STEP]) if run is None else segment.begin + run.contacts[:, EVENT_TIME]
    after = times[times > viewed]
    view = float(after[0]) + VIEW_BEYOND_CONTACT if len(after) else float(segment.t[-1])
    return min(max(view, viewed + MIN_VIEW_STEP), viewed + MAX_VIEW_STEP, float(segment.t[-1]))


def is_explained(model: ShotWindows, guess: ShotGuess, variance_ratio: float) -> bool:
    """Test whether the observations are explained as well as the first moments were.

    Args:
        model: Model of the part of the shot that is fitted.
        guess: Fitted states and parameters.
        variance_ratio: Residual over nominal variance of the first moments.

    Returns:
        True if the total cost and the cost of every ball in every interval are not significantly too large. A wrong
        spin shows for a while after a cushion.
    """
    costs = []
    for k, window in enumerate(model.windows):
        cost = huber_losses(model.simulate(k, guess.starts[k], guess.shared).residual)
        interval = ((window.t - window.t[0]) / ASSESSMENT_TIME).astype(int)
        part = window.body + (int(window.body.max(initial=0)) + 1) * interval
        costs += [(cost, _SIGNIFICANT_TOTAL), *((cost[part == one], _SIGNIFICANT_PART) for one in np.unique(part))]
    return all(
        one.sum() <= _EXPECTED_COST * variance_ratio * (len(one) + clear * np.sqrt(len(one))) for one, clear in costs
    )


def _fit_first_view(model: ShotWindows, shared: FloatArray) -> tuple[ShotGuess, float]:
    """Fit the first moments from every initial guess; return the best, and its variance ratio, at least 1."""
    part = replace(model, segments=(model.segments[0].truncate(float(model.segments[0].t[0]) + FIRST_VIEW),))
    window = part.windows[0]
    trials = [
        fit_windows(part, shared, _TRIAL_OPTIONS, (start,)) for start in (window.start, *window.alternative_starts)
    ]
    best_trial = min(trials, key=lambda one: one.cost)
    best = fit_windows(part, best_trial.shared, _GROWTH_OPTIONS, best_trial.starts)
    most = 1 + _SIGNIFICANT_TOTAL / np.sqrt(max(len(window.t), 1))
    variance_ratio = (
        1.0 if np.isnan(best.chi2_per_dof) else float(np.clip(best.chi2_per_dof / most, 1.0, _MAX_VARIANCE_RATIO))
    )
    return _to_guess(best), variance_ratio


def _refit_from_samples(
    before: ShotWindows, part: ShotWindows, guess: ShotGuess, fitted: ShootingFit, rng: np.random.Generator
) -> ShootingFit:
    """Refit `part` from posterior samples of the fit to `before`; return the best, or `fitted`."""
    guesses = _select_samples(before, part, guess, rng)
    trials = sorted(
        (fit_windows(part, one.shared, _TRIAL_OPTIONS, one.starts) for one in guesses), key=lambda one: one.cost
    )
    best = [fit_windows(part, one.shared, _GROWTH_OPTIONS, one.starts) for one in trials[:_FOLLOWED_SAMPLES]]
    return min([fitted, *best], key=lambda one: one.cost)


def _select_samples(
    before: ShotWindows, part: ShotWindows, current: ShotGuess, rng: np.random.Generator
) -> list[ShotGuess]:
    """Select the posterior samples that explain `part` best, one of each order of contacts first."""
    previous = current.starts[: len(before.windows)]
    problem = ShootingProblem(part, part.windows, (tuple(range(len(part.windows))),))
    candidates = []
    posterior = GaussianPosterior.around_fit(before, previous, current.shared, _SAMPLE_WIDENING)
    for sample in posterior.sample(_SAMPLE_COUNT, rng):
        guess = _add_new_windows(part, ShotGuess(*sample))
        point = simulate_chains(problem, guess.starts, guess.shared)
        candidates.append((point.cost, tuple(flow.event_order for flow in point.windows), guess))
    candidates.sort(key=lambda one: one[0])
    orders = [order for _, order, _ in candidates]
    firsts = [k for k, order in enumerate(orders) if order not in orders[:k]][: _REFITTED_SAMPLES // 2]
    ranked = [*firsts, *(k for k in range(len(candidates)) if k not in firsts)]
    return [candidates[k][2] for k in ranked[:_REFITTED_SAMPLES] if np.isfinite(candidates[k][0])]


def _add_new_windows(part: ShotWindows, guess: ShotGuess) -> ShotGuess:
    """Add starts of newly included windows; their spin is that at the end of the previous window."""
    starts = list(guess.starts)
    for k in range(len(starts), len(part.windows)):
        window, end = part.windows[k], part.simulate(k - 1, starts[k - 1], guess.shared).end
        tied = np.zeros(len(window.start), bool) if window.link_sigma is None else np.isfinite(window.link_sigma)
        starts.append(np.where(tied, end, window.start) if len(end) else window.start)
    return ShotGuess(tuple(starts), guess.shared)


def _to_guess(fitted: ShootingFit) -> ShotGuess:
    return ShotGuess(fitted.starts, fitted.shared)
