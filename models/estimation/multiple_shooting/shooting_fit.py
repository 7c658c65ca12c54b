"""Multiple shooting: fit the start states of all windows and the parameters that they share.

A recording is cut into windows, each simulated from a start state of its own, so that no simulation runs long enough to
forget its start (Bock 1983, doi:10.1007/978-1-4684-3324-1_15). Consecutive windows are linked by pseudo-observations of
continuity, whose standard deviations express what may change between them: everything at a strike, nothing where a
window was cut because the motion had become too sensitive. Priors enter as pseudo-observations too; single outliers are
bounded by Huber's loss.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Parameter
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_problem import (
    LEAST_GAIN,
    ChainTask,
    Iterate,
    ShootingProblem,
    assemble_normal_equations,
    assemble_state_block,
    build_problem,
    chain_cost,
    coordinate_bounds,
    linearize_chains,
    map_chains,
    prior_terms,
    require_linearized,
    simulate_chain,
    simulate_chains,
    value_derivatives,
    values_from_coordinates,
)
from models.estimation.multiple_shooting.shooting_windows import ShootingModel
from models.estimation.multiple_shooting.state_elimination import ChainBlock, eliminate_states, log_determinant
from models.numerics.executor import SERIAL, Executor
from models.numerics.least_squares import (
    Minimum,
    SearchOptions,
    count_determined,
    minimize_cost,
    search_minimum,
    solve_damped,
)
from models.numerics.statistics import evaluate_huber_loss, measure_lack_of_fit
from models.physics.effect import Prior

# Ratio of posterior to prior standard deviation above which the data did not determine a parameter.
PRIOR_DOMINATED = 0.8
# Increase of the cost of one chain, in a step that should lower it, from which its states are fitted again.
_COST_JUMP = 4.0
# Iterations of the states of one chain after a jump of its cost; the next steps of everything move them further.
_SETTLING_ITERATIONS = 4
# Robust chi2 per observed coordinate up to which noise explains a chain: a wrong guess would not come as near.
_NOISE_CHI2 = 1.3
# Windows of a chain on which its initial guesses are compared, 2 s of billiards: by then a spin has met a cushion or
# has decayed.
_GUESS_WINDOWS = 4
# Robust chi2 per observation up to which the states of a chain count as found.
_EXPLAINED_CHI2 = 4.0
# Growing shares of the windows to which the states are fitted, one after another.
_EARLY_SHARES, _LATER_SHARES = (0.2, 0.35, 0.5), (0.7, 0.85)
# Initial guesses that are followed beyond `_EARLY_SHARES`: a good early fit predicts a good final one, and each costs
# as much.
_FOLLOWED_GUESSES = 2
# Standard deviations of its prior that a shared parameter may move in one step. Where paths are smooth, its distance
# from the mean of the prior may double: what is many times its usual size is still reached in a few steps.
_MAX_PARAMETER_STEP = 1.0
# Of the states of a chain.
_SEARCH = SearchOptions(
    iterations=40, attempts=10, min_gain=0.02, least_damping=1e-9, raising_offset=1e-4,
    largest_damping=1e8,
)  # fmt: skip
# Predicted decrease of the cost up to which a stopped search counts as converged.
_REMAINING_DECREASE = 2.0


@dataclass(frozen=True, slots=True)
class ShootingOptions:
    """Iteration limits of a fit, and what its paths are like."""

    iterations: int = 40
    """Iterations of all windows together."""
    shot_iterations: int = 12
    """Iterations of the states of one chain alone, after a jump of its cost or for its initial guesses."""
    is_smooth: bool = False
    """Whether paths are smooth functions of start and parameters, without contacts and chaos: the cost of a chain does
    not jump then, and its initial guess leads to its best states."""
    tries_all_guesses: bool = False
    """Whether a chain is fitted from all of its initial guesses, also where the first one explains it: noise may hide
    another one that explains it better."""
    least_gain: float = LEAST_GAIN
    """Relative gain of a step below which a search ends."""


@dataclass(frozen=True, eq=False)
class ShootingFit:
    """The best-fitting start states and shared parameters.

    Uncertainties and the evidence need the derivatives at the best fit. Most fits of a search are compared by their
    cost alone, so that each of these is computed when it is first asked for.
    """

    starts: tuple[FloatArray, ...]
    """(S,) start state of each window."""
    shared: FloatArray
    """(P,)"""
    cost: float
    """Robust chi2 of the observations and chi2 of all pseudo-observations."""
    converged: bool
    problem: ShootingProblem
    point: Iterate
    """The best fit, about which the uncertainties hold."""

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the shared parameters in their own units, inflated by the lack of fit."""
        slope = value_derivatives(self.problem.model.unknowns, self.point.shared)
        return self._posterior * slope * slope[:, None]

    @property
    def sigma(self) -> FloatArray:
        """(P,) standard deviations of the shared parameters."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def prior_only(self) -> NDArray[np.bool_]:
        """(P,) True where the data did not determine a parameter: its value and error are mostly the prior's."""
        scale = prior_terms(self.problem.model.unknowns, self.point.shared)[0]
        return np.asarray(np.sqrt(np.diag(self._posterior)) > PRIOR_DOMINATED / scale)

    @property
    def chi2_per_dof(self) -> float:
        """Robust, of the observations alone."""
        return self._lack_of_fit[0]

    @property
    def inflation(self) -> float:
        """>= 1: factor on variances for residuals that are larger than their nominal errors or correlated in time."""
        return self._lack_of_fit[1]

    @cached_property
    def log_evidence(self) -> float:
        """Log of the marginal likelihood (Laplace approximation).

        It uses the nominal errors, so that only evidences of the same data compare. It is the height of the maximum
        times its width, divided by the widths of the priors; a state without a prior counts with a width of 1 in its
        unit.
        """
        prior = prior_terms(self.problem.model.unknowns, self.point.shared)[1]
        width = -np.linalg.slogdet(np.diag(prior) + self._data_information)[1]
        width -= sum(log_determinant(block.states) for block in self._linearized[1])
        log_width = float(np.log(prior).sum())
        for window in self.problem.windows:
            for sigma in (window.sigma, np.empty(0) if window.link_sigma is None else window.link_sigma):
                log_width -= 2 * float(np.log(sigma[np.isfinite(sigma)]).sum())
        return 0.5 * float(log_width + width - self.point.cost)

    @cached_property
    def start_covariances(self) -> tuple[FloatArray, ...]:
        """(S, S) covariance of each start state: of its chain, plus the errors of the shared parameters."""
        covariances: list[FloatArray] = [np.empty((0, 0))] * len(self.problem.windows)
        for numbers, block in zip(self.problem.chains, self._linearized[1], strict=True):
            inner = solve_damped(block.states, np.eye(len(block.gradient)), 0.0) * self.inflation
            response = solve_damped(block.states, block.coupling, 0.0)
            whole, offset = inner + response @ self._posterior @ response.T, 0
            for k in numbers:
                here = slice(offset, offset + len(self.point.starts[k]))
                covariances[k] = whole[here, here]
                offset += len(self.point.starts[k])
        return tuple(covariances)

    @cached_property
    def _linearized(self) -> tuple[Iterate, list[ChainBlock]]:
        """The fit with all Jacobians, and the normal equations of every chain."""
        return linearize_chains(self.problem, self.point)

    @cached_property
    def _data_information(self) -> FloatArray:
        """(P, P) information of the data on the search coordinates, start states marginalized."""
        size = len(self.point.shared)
        return sum((block.schur_complement() for block in self._linearized[1]), np.zeros((size, size)))

    @cached_property
    def _posterior(self) -> FloatArray:
        """(P, P) covariance of the search coordinates, inflated by the lack of fit."""
        prior = prior_terms(self.problem.model.unknowns, self.point.shared)[1]
        information = self._data_information / self.inflation + np.diag(prior)
        return solve_damped(information, np.eye(len(prior)), 0.0)

    @cached_property
    def _lack_of_fit(self) -> tuple[float, float]:
        """Robust chi2 per degree of freedom, and the variance inflation that the residuals require."""
        series, free = [], 0
        for k, window in enumerate(self.problem.windows):
            prediction = require_linearized(self._linearized[0], k)
            bounded = prediction.residual * np.sqrt(evaluate_huber_loss(prediction.residual)[0])[:, None]
            series += [bounded[window.body == body] for body in np.unique(window.body)]
            free += count_determined(prediction.start_jacobian.reshape(-1, len(window.start)))
        return measure_lack_of_fit(series, free)


def fit_windows(
    model: ShootingModel,
    shared: FloatArray | None = None,
    options: ShootingOptions = ShootingOptions(),
    starts: tuple[FloatArray, ...] | None = None,
    retry_guesses: bool = False,
    executor: Executor = SERIAL,
) -> ShootingFit:
    """Fit the start states of all windows and the shared parameters of a model.

    Args:
        model: Model with windows and priors.
        shared: (P,) initial guess of the shared parameters; the means of the priors where not given.
        options: Iteration limits.
        starts: (S,) start state of each window from an earlier fit, which is continued.
        retry_guesses: With `starts`: also try the initial guesses of the windows, and keep the better ones.
        executor: Distributes the chains over processes; it does not change the result.

    Returns:
        The fit; `converged` is False where the iterations ended first.
    """
    problem = build_problem(model, executor, options.least_gain)
    first = np.array([prior.value for prior in model.unknowns]) if shared is None else np.array(shared, float)
    guesses = tuple(w.start.copy() for w in problem.windows)
    point = simulate_chains(problem, guesses if starts is None else starts, first)
    if starts is None or retry_guesses:
        more = () if starts is None else (guesses,)
        point, _ = map_chains(problem, _fit_best_guess, point, range(len(problem.chains)), options, more)
    point, converged = _minimize_cost(problem, point, options)
    return ShootingFit(point.starts, point.shared, point.cost, converged, problem, point)


def summarize_parameters(unknowns: tuple[Prior, ...], fitted: ShootingFit) -> tuple[Parameter, ...]:
    """Convert the fitted shared parameters into a result table.

    Args:
        unknowns: (P,) priors of the shared parameters.
        fitted: Fit of these parameters.

    Returns:
        One parameter per prior: value, sigma, unit, and whether the prior determined it.
    """
    return tuple(
        Parameter(prior.name, float(value), float(sigma), prior.unit, bool(only))
        for prior, value, sigma, only in zip(unknowns, fitted.shared, fitted.sigma, fitted.prior_only, strict=True)
    )


def convert_to_priors(unknowns: tuple[Prior, ...], fitted: ShootingFit) -> tuple[Prior, ...]:
    """Convert the result of a fit into priors for the fit of other recordings, without correlations.

    Args:
        unknowns: (P,) priors of the shared parameters.
        fitted: Fit of these parameters.

    Returns:
        (P,) priors with the fitted values and standard deviations.
    """
    return tuple(
        replace(prior, value=float(value), sigma=float(sigma / value if prior.relative else sigma))
        for prior, value, sigma in zip(unknowns, fitted.shared, fitted.sigma, strict=True)
    )


def _minimize_cost(problem: ShootingProblem, now: Iterate, options: ShootingOptions) -> tuple[Iterate, bool]:
    """Minimize the cost by damped steps; return the last iterate and whether it converged.

    Without shared parameters, chains have nothing in common: each is fitted alone, with a damping of its own.
    """
    if not problem.model.unknowns:
        point, converged = map_chains(problem, _converge_chain, now, range(len(problem.chains)), options.iterations)
        return point, all(converged)
    settling = min(options.shot_iterations, _SETTLING_ITERATIONS)

    def move(now: Iterate, step: tuple[FloatArray, list[FloatArray], FloatArray]) -> tuple[Iterate, float]:
        trial = _take_step(problem, now, step)
        if not options.is_smooth:
            trial = _refit_worse_chains(problem, now, trial, settling)
        return trial, trial.cost

    best = minimize_cost(
        now,
        now.cost,
        lambda now: (now, assemble_normal_equations(problem, now)),
        lambda linear, damping: _solve_step(problem, *linear, damping, options.is_smooth),
        move,
        replace(_SEARCH, iterations=options.iterations, quiet_steps=2, min_relative_gain=problem.least_gain),
    )
    if best.outcome == "stalled" and best.linear is not None:
        return best.point, _predict_decrease(problem, *best.linear) < _REMAINING_DECREASE
    return best.point, best.outcome == "converged"


def _predict_decrease(problem: ShootingProblem, now: Iterate, blocks: list[ChainBlock]) -> float:
    """Predict the remaining decrease of the cost from the derivatives: large where a search is stuck at a kink."""
    shared_step, state_steps, gradient = _solve_step(problem, now, blocks, 0.0)
    gain = float(gradient @ shared_step)
    return -gain - sum(float(block.gradient @ step) for block, step in zip(blocks, state_steps, strict=True))


def _refit_worse_chains(problem: ShootingProblem, before: Iterate, trial: Iterate, settling: int) -> Iterate:
    """Refit the states of every chain that a trial step made worse.

    One chain that changes its order of contacts must not block a step that is good for all others. A step that is not
    good for them is too long; refitting would only hide that.
    """
    with np.errstate(invalid="ignore"):
        gains = before.costs - trial.costs
    is_worse = ~(gains[:-1] >= -_COST_JUMP)
    if len(is_worse) < 2 or not is_worse.any() or not gains[np.append(~is_worse, True)].sum() > _COST_JUMP:
        return trial
    worse = [int(k) for k in np.flatnonzero(is_worse)]
    return map_chains(problem, _fit_chain, trial, worse, settling)[0]


def _converge_chain(
    problem: ShootingProblem, now: Iterate, chain: int, iterations: int
) -> ChainTask[tuple[Iterate, bool]]:
    """Fit the states of one chain; return also whether the search converged."""
    best = yield from _search_chain_states(problem, now, chain, iterations, quiet_steps=2)
    is_converged = best.outcome == "converged"
    if best.outcome == "stalled" and best.linear is not None:
        step = solve_damped(best.linear.states, best.linear.gradient, 0.0)
        is_converged = float(best.linear.gradient @ step) < _REMAINING_DECREASE
    return best.point, is_converged


def _fit_chain(problem: ShootingProblem, now: Iterate, chain: int, iterations: int) -> ChainTask[tuple[Iterate, None]]:
    """Fit the states of one chain."""
    return (yield from _search_chain_states(problem, now, chain, iterations)).point, None


def _search_chain_states(
    problem: ShootingProblem, now: Iterate, chain: int, iterations: int, share: float = 1.0, quiet_steps: int = 1
) -> ChainTask[Minimum[Iterate, ChainBlock]]:
    """Search the best states of one chain for the first `share` of its windows, with fixed shared parameters."""
    cost = chain_cost(problem, now, chain, share)

    def move(now: Iterate, step: FloatArray) -> ChainTask[tuple[Iterate, float]]:
        trial = yield from simulate_chain(problem, now, chain, _move_starts(problem, now.starts, {chain: step}))
        return trial, chain_cost(problem, trial, chain, share)

    return (
        yield from search_minimum(
            now,
            cost,
            lambda now: assemble_state_block(problem, now, chain, share),
            lambda block, damping: -solve_damped(block.states, block.gradient, damping),
            move,
            replace(
                _SEARCH,
                iterations=iterations if np.isfinite(cost) else 0,
                quiet_steps=quiet_steps,
                min_relative_gain=problem.least_gain,
            ),
        )
    )


def _fit_best_guess(
    problem: ShootingProblem,
    now: Iterate,
    chain: int,
    options: ShootingOptions,
    more: tuple[tuple[FloatArray, ...], ...],
) -> ChainTask[tuple[Iterate, None]]:
    """Fit the states of one chain from each of its initial guesses and return the best.

    `more` are further start states of all windows. Where an alternative guess of a window differs from its first guess,
    it replaces that coordinate only; the others keep their current values. In long chains, the guesses are compared on
    the first windows.
    """
    own = problem.chains[chain]
    guesses = [now.starts] + [
        tuple(other[k] if k in own else start for k, start in enumerate(now.starts)) for other in more
    ]
    alternatives = [
        (*now.starts[:k], np.where(other == problem.windows[k].start, now.starts[k], other), *now.starts[k + 1 :])
        for k in own
        for other in problem.windows[k].alternative_starts
    ]
    if len(own) > _GUESS_WINDOWS and alternatives:
        heads = replace(problem, chains=tuple(numbers[:_GUESS_WINDOWS] for numbers in problem.chains))
        starts = (yield from _fit_guesses(heads, now, chain, options, [*guesses, *alternatives])).starts
        first, end = own[0], own[_GUESS_WINDOWS]
        guesses, alternatives = [(*one[:first], *starts[first:end], *one[end:]) for one in guesses], []
    return (yield from _fit_guesses(problem, now, chain, options, [*guesses, *alternatives])), None


def _fit_guesses(
    problem: ShootingProblem, now: Iterate, chain: int, options: ShootingOptions, guesses: list[tuple[FloatArray, ...]]
) -> ChainTask[Iterate]:
    """Fit the states of one chain from each of these start states of all windows and return the best."""
    own = problem.chains[chain]
    count = sum(len(problem.windows[k].t) for k in own)
    fits: list[Iterate] = []
    for starts in guesses:
        guess = yield from simulate_chain(problem, now, chain, starts)
        fits.append((yield from _search_chain_states(problem, guess, chain, options.shot_iterations)).point)
        explained = _NOISE_CHI2 * sum(fits[-1].windows[k].residual.size for k in own)
        if not options.tries_all_guesses and fits[-1].costs[chain] <= explained:
            return fits[-1]
    best = min(fits, key=lambda one: float(one.costs[chain]))
    if options.is_smooth or best.costs[chain] <= _EXPLAINED_CHI2 * count:
        return best
    early = []
    for starts in guesses:
        guess = yield from simulate_chain(problem, now, chain, starts)
        early.append((yield from _fit_growing_share(problem, guess, chain, options, _EARLY_SHARES)))
    early.sort(key=lambda one: chain_cost(problem, one, chain, _EARLY_SHARES[-1]))
    for one in early[:_FOLLOWED_GUESSES]:
        slow = yield from _fit_growing_share(problem, one, chain, options, (*_LATER_SHARES, 1.0))
        best = min(best, slow, key=lambda one: float(one.costs[chain]))
    return best


def _fit_growing_share(
    problem: ShootingProblem, point: Iterate, chain: int, options: ShootingOptions, shares: tuple[float, ...]
) -> ChainTask[Iterate]:
    """Fit the states to growing shares of a chain's windows, so that contacts are included one after another."""
    for share in shares:
        iterations = options.shot_iterations if share == 1.0 else options.shot_iterations // 3 + 1
        point = (yield from _search_chain_states(problem, point, chain, iterations, share)).point
    return point


def _take_step(
    problem: ShootingProblem, now: Iterate, step: tuple[FloatArray, list[FloatArray], FloatArray]
) -> Iterate:
    """Apply a step of everything, see `_solve_step`, and simulate the result."""
    shared_step, state_steps, _ = step
    coordinates, low, high = coordinate_bounds(problem.model.unknowns, now.shared)
    moved = np.clip(coordinates + shared_step, low, high)
    starts = _move_starts(problem, now.starts, dict(enumerate(state_steps)))
    return simulate_chains(problem, starts, values_from_coordinates(problem.model.unknowns, moved))


def _move_starts(
    problem: ShootingProblem, starts: tuple[FloatArray, ...], steps: Mapping[int, FloatArray]
) -> tuple[FloatArray, ...]:
    """Move the start states of chains by steps (M,) of all their states."""
    moved = list(starts)
    for chain, step in steps.items():
        offset = 0
        for k in problem.chains[chain]:
            moved[k] = starts[k] + step[offset : offset + len(starts[k])]
            offset += len(starts[k])
    return tuple(moved)


def _solve_step(
    problem: ShootingProblem, now: Iterate, blocks: list[ChainBlock], damping: float, may_double: bool = False
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Compute the steps of the shared parameters (P,) and of the states of every chain, and the gradient (P,)."""
    scale, prior_h, prior_g = prior_terms(problem.model.unknowns, now.shared)
    coordinates, low, high = coordinate_bounds(problem.model.unknowns, now.shared)
    gradient: FloatArray = prior_g + sum(block.shared_gradient for block in blocks)
    is_fixed = ((coordinates <= low) & (gradient > 0)) | ((coordinates >= high) & (gradient < 0))
    longest = np.maximum(_MAX_PARAMETER_STEP, np.abs(prior_g / scale) * may_double) / scale
    reach = np.maximum(low - coordinates, -longest), np.minimum(high - coordinates, longest)
    return *eliminate_states(blocks, np.diag(prior_h), prior_g, damping, is_fixed, reach), gradient
