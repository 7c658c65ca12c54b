"""Multiple shooting: the start of every window and the numbers that windows share, from what was seen.

A recording is cut into windows, each simulated from a start state of its own, so that no simulation runs long enough
to forget its start (Bock 1983, doi:10.1007/978-1-4684-3324-1_15). Windows that follow each other are tied by pseudo-
observations of continuity, whose standard deviations say what may change between them: everything at a strike,
nothing where a window was cut because the motion had become too sensitive. What is known beforehand enters as
pseudo-observations too; single bad observations are bounded by Huber's loss.

Nothing here knows what moves: a scene offers a `Model`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Parameter
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.lack_of_fit import correlation_factor
from models.estimation.multiple_shooting.normal_equations import (
    glanced,
    huber,
    normal_blocks,
    shot_cost,
    sloped,
    sloped_everywhere,
    states_block,
)
from models.estimation.multiple_shooting.shared_parameters import bounds, prior_knowledge, slopes, values_of
from models.estimation.multiple_shooting.shooting_problem import (
    Attempt,
    Part,
    Problem,
    by_shot,
    of_part,
    part_of,
    problem_of,
    with_parts,
)
from models.estimation.multiple_shooting.shooting_windows import Model, glance
from models.estimation.multiple_shooting.state_elimination import ShotBlock, eliminate, log_determinant, solved
from models.numerics.executor import ALONE, Crew
from models.physics.effect import Prior

UNDETERMINED = 0.8
"""share of the prior's standard deviation above which the data did not determine a number."""
_SETTLED = 0.02
"""cost that an iteration must gain: far below what matters."""
_JUMP = 4.0
"""rise of the cost of a shot, in a step that should lower it, from which its own states are sought anew."""
_EXPLAINED = 4.0
"""robust chi2 per observation up to which the states of a shot count as found."""
_EARLY, _LATER = (0.2, 0.35, 0.5), (0.7, 0.85)
"""shares of the windows that states are fitted to, one after another."""
_HOPEFUL = 2
"""first guesses that are followed further than `_EARLY`: what begins better ends better, and each costs as much."""
_STRIDE = 1.0
"""standard deviations of its prior that a shared number may move in one step."""
_DAMPINGS = 10
"""how often a step is shortened before the search gives up."""
_LEFT = 2.0
"""cost that may still be promised where a search has converged."""


@dataclass(frozen=True, slots=True)
class ShootingOptions:
    """How long to problem."""

    iterations: int = 40
    """of all windows together."""
    settling: int = 12
    """of the states of one shot alone, where its loss jumped or at the beginning."""


@dataclass(frozen=True, slots=True)
class Shooting:
    """The best-fitting starts and shared numbers."""

    starts: tuple[FloatArray, ...]
    """per window (S,)."""
    shared: FloatArray
    """(P,)"""
    covariance: FloatArray
    """(P, P) of the shared numbers, scaled by the lack of fit; in their own units."""
    prior_only: NDArray[np.bool_]
    """(P,) True where the data did not determine a number: its value and error are mostly the prior's."""
    cost: float
    """robust chi2 of the observations with all pseudo-observations."""
    chi2_per_dof: float
    """robust, of the observations alone."""
    log_evidence: float
    """of the model: log of its likelihood with starts and shared numbers integrated out (Laplace); errors are taken
    as promised, so that only evidences of the same data compare."""
    inflation: float
    """>= 1: factor on variances for residuals larger than promised, and alike from one moment to the next."""
    start_covariances: tuple[FloatArray, ...]
    """per window (S, S), the shared numbers free."""
    converged: bool

    @property
    def sigma(self) -> FloatArray:
        """(P,) standard deviations of the shared numbers."""
        return np.sqrt(np.diag(self.covariance))


def shoot(
    model: Model,
    shared: FloatArray | None = None,
    options: ShootingOptions = ShootingOptions(),
    starts: tuple[FloatArray, ...] | None = None,
    anew: bool = False,
    crew: Crew = ALONE,
) -> Shooting:
    """Fit a model, from the guesses of its windows and from `shared` (P,), the priors' values where not given.

    `starts`, (S,) per window, continue an earlier fit: other first guesses are then tried only where they are sought
    `anew`, and the better ones kept. The `crew` shares out the shots.
    """
    problem = problem_of(model, crew)
    first = np.array([prior.value for prior in model.unknowns]) if shared is None else np.array(shared, float)
    seen = tuple(w.start.copy() for w in problem.windows)
    now = glanced(problem, seen if starts is None else starts, first)
    if starts is None or anew:
        shots, more = range(len(problem.shots)), () if starts is None else (seen,)
        parts = by_shot(problem, _begun_part, now, shots, options, more)
        now = with_parts(problem, now, dict(zip(shots, parts, strict=True)))
    now, converged = _descend(problem, now, options)
    return _result(problem, now, converged)


def parameters_of(unknowns: tuple[Prior, ...], found: Shooting) -> tuple[Parameter, ...]:
    """The shared numbers as results of a fit."""
    return tuple(
        Parameter(prior.name, float(value), float(sigma), prior.unit, bool(only))
        for prior, value, sigma, only in zip(unknowns, found.shared, found.sigma, found.prior_only, strict=True)
    )


def priors_of(unknowns: tuple[Prior, ...], found: Shooting) -> tuple[Prior, ...]:
    """What a fit found, as what is known beforehand by the fit of other recordings; correlations are left out."""
    return tuple(
        replace(prior, value=float(value), sigma=float(sigma / value if prior.relative else sigma))
        for prior, value, sigma in zip(unknowns, found.shared, found.sigma, strict=True)
    )


def _descend(problem: Problem, now: Attempt, options: ShootingOptions) -> tuple[Attempt, bool]:
    damping, quiet = 1e-3, 0
    for _ in range(options.iterations):
        blocks = normal_blocks(problem, now)
        for _ in range(_DAMPINGS):
            trial = _stepped(problem, now, blocks, damping)
            trial = _mended(problem, now, trial, options.settling)
            if trial.cost < now.cost:
                break
            damping = min(damping * 6 + 1e-4, 1e8)
        else:
            return now, _promise(problem, now, blocks) < _LEFT
        quiet = quiet + 1 if now.cost - trial.cost < _SETTLED + 1e-6 * now.cost else 0
        now, damping = trial, max(damping * 0.15, 1e-9)
        if quiet == 2:
            return now, True
    return now, False


def _promise(problem: Problem, now: Attempt, blocks: list[ShotBlock]) -> float:
    """By how much the slopes say that the cost can still fall: much of it where a search is caught at a kink."""
    shared_step, state_steps, gradient = _full_step(problem, now, blocks, 0.0)
    gain = float(gradient @ shared_step)
    return -gain - sum(float(block.gradient @ step) for block, step in zip(blocks, state_steps, strict=True))


def _mended(problem: Problem, before: Attempt, trial: Attempt, settling: int) -> Attempt:
    """The trial, after the states of every shot that got worse were sought anew: one shot that changes the order of
    its contacts must not block a step that is good for all others."""
    worse = [k for k in range(len(problem.shots)) if not trial.costs[k] <= before.costs[k] + _JUMP]
    if not worse or len(problem.shots) < 2:
        return trial
    parts = by_shot(problem, _settled_part, trial, worse, settling)
    return with_parts(problem, trial, dict(zip(worse, parts, strict=True)))


def _settled_part(problem: Problem, part: Part, shared: FloatArray, shot: int, iterations: int) -> Part:
    return part_of(problem, _settled(problem, of_part(problem, part, shared, shot), shot, iterations), shot)


def _settled(problem: Problem, now: Attempt, shot: int, iterations: int, share: float = 1.0) -> Attempt:
    """The states of one shot fitted to the first `share` of each of its windows, shared numbers kept."""
    damping = 1e-3
    cost = shot_cost(problem, now, shot, share)
    for _ in range(iterations if np.isfinite(cost) else 0):
        block = states_block(problem, now, shot, share)
        for _ in range(_DAMPINGS):
            step = -solved(block.states, block.gradient, damping)
            trial = _with_states(problem, now, shot, step)
            new_cost = shot_cost(problem, trial, shot, share)
            if new_cost < cost:
                break
            damping = min(damping * 6 + 1e-4, 1e8)
        else:
            return now
        gain, now, cost, damping = cost - new_cost, trial, new_cost, max(damping * 0.15, 1e-9)
        if gain < _SETTLED + 1e-6 * cost:
            return now
    return now


def _begun_part(
    problem: Problem,
    part: Part,
    shared: FloatArray,
    shot: int,
    options: ShootingOptions,
    more: tuple[tuple[FloatArray, ...], ...],
) -> Part:
    return part_of(problem, _begun(problem, of_part(problem, part, shared, shot), shot, options, more), shot)


def _begun(
    problem: Problem, now: Attempt, shot: int, options: ShootingOptions, more: tuple[tuple[FloatArray, ...], ...] = ()
) -> Attempt:
    """The states of one shot from the best of its first guesses, those in `more` (starts of all windows) among them;
    what the others of a window guess differently stands beside what is known of the rest by now."""
    own = problem.shots[shot]
    guesses = [now.starts] + [
        tuple(other[k] if k in own else start for k, start in enumerate(now.starts)) for other in more
    ]
    guesses += [
        (*now.starts[:k], np.where(other == problem.windows[k].start, now.starts[k], other), *now.starts[k + 1 :])
        for k in own
        for other in problem.windows[k].others
    ]
    tried = [_settled(problem, _guessed(problem, now, shot, starts), shot, options.settling) for starts in guesses]
    best = min(tried, key=lambda one: float(one.costs[shot]))
    seen = sum(len(problem.windows[k].t) for k in problem.shots[shot])
    if best.costs[shot] <= _EXPLAINED * seen:
        return best
    early = [_grown(problem, _guessed(problem, now, shot, starts), shot, options, _EARLY) for starts in guesses]
    early.sort(key=lambda one: shot_cost(problem, one, shot, _EARLY[-1]))
    slow = [_grown(problem, one, shot, options, (*_LATER, 1.0)) for one in early[:_HOPEFUL]]
    return min([best, *slow], key=lambda one: float(one.costs[shot]))


def _guessed(problem: Problem, now: Attempt, shot: int, starts: tuple[FloatArray, ...]) -> Attempt:
    """The same, with other starts in one shot."""
    flows, costs = list(now.flows), now.costs.copy()
    for k in problem.shots[shot]:
        flows[k] = glance(problem.model, k, starts[k], now.shared)
    guess = Attempt(starts, now.shared, tuple(flows), costs)
    costs[shot] = shot_cost(problem, guess, shot)
    return guess


def _grown(problem: Problem, now: Attempt, shot: int, options: ShootingOptions, seen: tuple[float, ...]) -> Attempt:
    """States fitted to more and more of a shot's windows, so that contacts come into view one after another."""
    for share in seen:
        now = _settled(problem, now, shot, options.settling if share == 1.0 else options.settling // 3 + 1, share)
    return now


def _stepped(problem: Problem, now: Attempt, blocks: list[ShotBlock], damping: float) -> Attempt:
    shared_step, state_steps, _ = _full_step(problem, now, blocks, damping)
    coordinates, low, high = bounds(problem.model.unknowns, now.shared)
    moved = np.clip(coordinates + shared_step, low, high)
    starts = list(now.starts)
    for numbers, step in zip(problem.shots, state_steps, strict=True):
        offset = 0
        for k in numbers:
            starts[k] = now.starts[k] + step[offset : offset + len(now.starts[k])]
            offset += len(now.starts[k])
    return glanced(problem, tuple(starts), values_of(problem.model.unknowns, moved))


def _full_step(
    problem: Problem, now: Attempt, blocks: list[ShotBlock], damping: float
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Steps of the shared numbers (P,) and of the states of every shot, and the gradient by the former (P,)."""
    scale, prior_h, prior_g = prior_knowledge(problem.model.unknowns, now.shared)
    coordinates, low, high = bounds(problem.model.unknowns, now.shared)
    gradient: FloatArray = prior_g + sum(block.shared_gradient for block in blocks)
    held = ((coordinates <= low) & (gradient > 0)) | ((coordinates >= high) & (gradient < 0))
    reach = np.maximum(low - coordinates, -_STRIDE / scale), np.minimum(high - coordinates, _STRIDE / scale)
    return *eliminate(blocks, np.diag(prior_h), prior_g, damping, held, reach), gradient


def _with_states(problem: Problem, now: Attempt, shot: int, step: FloatArray) -> Attempt:
    starts, offset = list(now.starts), 0
    for k in problem.shots[shot]:
        size = len(starts[k])
        starts[k] = starts[k] + step[offset : offset + size]
        offset += size
    return _guessed(problem, now, shot, tuple(starts))


def _result(problem: Problem, point: Attempt, converged: bool) -> Shooting:
    unknowns = problem.model.unknowns
    point, blocks = sloped_everywhere(problem, point)
    chi2, inflation = _lack_of_fit(problem, point)
    scale, prior_information, _ = prior_knowledge(unknowns, point.shared)
    data = sum((block.reduced() for block in blocks), np.zeros((len(scale), len(scale))))
    posterior = solved(data / inflation + np.diag(prior_information), np.eye(len(scale)), 0.0)
    slope = slopes(unknowns, point.shared)
    prior_only = np.sqrt(np.diag(posterior)) > UNDETERMINED / scale
    return Shooting(
        starts=point.starts,
        shared=point.shared,
        covariance=posterior * slope * slope[:, None],
        prior_only=prior_only,
        cost=point.cost,
        chi2_per_dof=chi2,
        log_evidence=_log_evidence(problem, point, blocks, np.diag(prior_information)),
        inflation=inflation,
        start_covariances=_start_covariances(problem, point, blocks, posterior, inflation),
        converged=converged,
    )


def _log_evidence(problem: Problem, point: Attempt, blocks: list[ShotBlock], prior: FloatArray) -> float:
    """Laplace: the height of the maximum times its width, over the widths of what was known beforehand; a state that
    nothing is known of beforehand counts with a width of 1 in its unit."""
    information = prior + sum(block.reduced() for block in blocks)
    width = -np.linalg.slogdet(information)[1] - sum(log_determinant(block.states) for block in blocks)
    known = float(np.log(np.diag(prior)).sum())
    for window in problem.windows:
        for sigma in (window.sigma, np.empty(0) if window.link is None else window.link):
            known -= 2 * float(np.log(sigma[np.isfinite(sigma)]).sum())
    return 0.5 * float(known + width - point.cost)


def _lack_of_fit(problem: Problem, point: Attempt) -> tuple[float, float]:
    """Robust chi2 per degree of freedom, and the factor on variances that the residuals ask for."""
    series, free = [], 0
    for k, window in enumerate(problem.windows):
        flow = sloped(point, k)
        bounded = flow.misfit * np.sqrt(huber(flow.misfit)[0])[:, None]
        series += [bounded[window.body == body] for body in np.unique(window.body)]
        free += int(np.linalg.matrix_rank(flow.by_start.reshape(-1, len(window.start)))) if len(flow.misfit) else 0
    count = sum(one.size for one in series)
    if count <= free:
        return float("nan"), 1.0
    chi2 = sum(float((one**2).sum()) for one in series) / (count - free)
    return chi2, max(1.0, chi2 * correlation_factor(series))


def _start_covariances(
    problem: Problem, point: Attempt, blocks: list[ShotBlock], shared: FloatArray, inflation: float
) -> tuple[FloatArray, ...]:
    """(S, S) per window: what its shot leaves open, and what the shared numbers' errors add."""
    found: list[FloatArray] = [np.empty((0, 0))] * len(problem.windows)
    for numbers, block in zip(problem.shots, blocks, strict=True):
        inner = solved(block.states, np.eye(len(block.gradient)), 0.0) * inflation
        response = solved(block.states, block.coupling, 0.0)
        whole, offset = inner + response @ shared @ response.T, 0
        for k in numbers:
            here = slice(offset, offset + len(point.starts[k]))
            found[k] = whole[here, here]
            offset += len(point.starts[k])
    return tuple(found)
