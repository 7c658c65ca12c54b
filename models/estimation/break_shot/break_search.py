"""Search for simulations of a break shot that end where the balls were observed.

The order of two contacts changes all that follows, so that the loss has as many local minima as there are orders.
Within one, exact derivatives of the simulation give the descent (Levenberg-Marquardt). Racks are drawn from their
measured places; first only observations shortly after the hit are used, when few contacts have happened; the better
racks go on, at first with inflated noise; and the best are perturbed and optimized again, as in basin hopping (Wales
and Doye 1997, doi:10.1021/jp970984n). At last samples are drawn around the best within its covariance: what all those
that end in the same place have in common is known.

The samples give the contacts of the break, each with its probability, and the states in which balls leave it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.shot import BreakContact, BreakExit, SimulatedBreak
from models.core.typing import FloatArray
from models.estimation.break_shot.break_simulation import BreakModel, BreakShot
from models.numerics.least_squares import (
    MIN_INFORMATION,
    NormalEquations,
    SearchOptions,
    minimize_cost,
    solve_normal_equations,
)
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_SPEED,
    EVENT_TIME,
)
from models.physics.billiards.simulation.parametrised_shot import MOVING_BALL_SIZE, convert_to_starts
from models.physics.billiards.simulation.simulated_shot import STATE_SIZE, SimulatedShot

# Most searches, and the chi2 per degree of freedom that ends them: local minima are many.
MAX_SEARCHES, GOOD_CHI2 = 2, 3.0
# Random racks at the start.
RANDOM_RACKS = 40
# Share of the time after the hit that is used, number of racks that go on, and optimization steps for each.
STAGES = ((0.4, 16, 5), (0.67, 8, 6), (1.0, 5, 12))
# Perturbations of one of the best, and steps to optimize it.
MAX_HOPS, OPTIMIZATION_STEPS = 200, 10
# Ball radii: initial noise level of all samples, about a pixel.
SOFT_NOISE_RADII = 0.07
# Ratio of the initial to the real noise above which it is lowered in steps.
MIN_NOISE_RATIO = 1.5
# chi2 per degree of freedom of the best rack so far above which basin hopping does not help.
MAX_CHI2 = 30.0
# Successive perturbations without a gain.
MAX_IDLE_HOPS = 50
# Samples drawn around the best.
POSTERIOR_DRAWS = 24
# Largest chi2 distance of a sample from the best.
MAX_CHI2_DISTANCE = 9.0
# Of the parameters of one rack.
_SEARCH = SearchOptions(
    iterations=OPTIMIZATION_STEPS, attempts=5, min_gain=0.5, damping=1e-2, lowering=0.2, raising=5.0, least_raised=1e-3
)
# Cost that a perturbation must gain to count.
_MIN_HOP_GAIN = 1.0
# Standard deviations per unit of a parameter.
_MAX_JACOBIAN = 1e12
# Ridge on a unit diagonal.
_RIDGE = 1e-9
# Powers of ten: standard deviations of the perturbations.
_HOP_POWERS = (-1.5, 0.0)


@dataclass(frozen=True, slots=True)
class BreakSample:
    """One simulation of a break, and its misfit."""

    parameters: FloatArray
    """(P,) as in `BreakModel`."""
    run: SimulatedShot
    residual: FloatArray
    """(R,) standard deviations, from `BreakModel.evaluate_residuals`."""
    cost: float


@dataclass(frozen=True, slots=True)
class BreakEnsemble:
    """M posterior samples of one break, the best one first."""

    break_shot: BreakShot
    samples: tuple[BreakSample, ...]
    weight: FloatArray
    """(M,) probabilities; they sum to 1."""
    covariance: FloatArray
    """(P, P) of the parameters of the best, scaled by its lack of fit."""
    chi2_per_dof: float
    """Robust, of the best."""


def search_break(break_shot: BreakShot, rng: np.random.Generator) -> BreakEnsemble | None:
    """Search for the simulations that explain a break best.

    Args:
        break_shot: The break shot with its observations.
        rng: Generator of the random racks.

    Returns:
        Posterior samples; None if nothing could be simulated.
    """
    best: BreakEnsemble | None = None
    for _ in range(MAX_SEARCHES):
        other = _search_from_random_racks(break_shot, rng)
        if best is None or (other is not None and other.chi2_per_dof < best.chi2_per_dof):
            best = other
        if best is None or best.chi2_per_dof < GOOD_CHI2:
            break
    return best


def _search_from_random_racks(break_shot: BreakShot, rng: np.random.Generator) -> BreakEnsemble | None:
    """Search from random racks drawn once."""
    model = BreakModel(break_shot, break_shot.end)
    value, sigma = model.prior
    sigma = np.where(np.isfinite(sigma), sigma, 0.0)  # what samples alone determine needs no draws
    draws = (value + sigma * rng.normal(size=len(value)) for _ in range(RANDOM_RACKS - 1))
    racks = [model.separate_balls(value), *map(model.make_feasible, draws)]
    noise_levels = _noise_levels(break_shot)
    best: list[BreakSample] = []
    for share, count, steps in STAGES:
        early_model = BreakModel(
            break_shot.inflate_noise(noise_levels[0]), break_shot.hit + share * (break_shot.end - break_shot.hit)
        )
        best = _optimize_racks(early_model, racks, steps)[:count]
        racks = [one.parameters for one in best]
    dof = max(2 * len(model.rows) - MOVING_BALL_SIZE, 1)
    if not best or best[0].cost > MAX_CHI2 * dof:
        return None
    for noise in noise_levels:
        noisy_model = BreakModel(break_shot.inflate_noise(noise), break_shot.end)
        best = _optimize_racks(noisy_model, [one.parameters for one in best], OPTIMIZATION_STEPS)
        best = _hop_basins(noisy_model, best, sigma, MAX_HOPS // len(noise_levels), rng)
    misfit = max(best[0].cost / dof, 1.0)
    axes = _posterior_axes(model, best[0]) * np.sqrt(misfit)
    around = [(best[0], 1.0), *_sample_around(model, best[0], axes, misfit, rng)]
    others = [np.exp(-(one.cost - best[0].cost) / (2 * misfit)) for one in best[1:]]
    weight = np.array([*(share / len(around) for _, share in around), *others])
    samples = (*(one for one, _ in around), *best[1:])
    return BreakEnsemble(break_shot, samples, weight / weight.sum(), axes @ axes.T, best[0].cost / dof)


def _noise_levels(break_shot: BreakShot) -> tuple[float, ...]:
    """Return noise factors from the first to the last stage.

    The smaller the noise, the narrower the local minima, and a rack that is nearly right looks as bad as any.
    """
    usual_sigma = float(np.median(1 / np.linalg.norm(break_shot.whiten, -2, axis=(1, 2))))
    largest = SOFT_NOISE_RADII * break_shot.table.ball_radius / usual_sigma
    return (largest, float(np.sqrt(largest)), 1.0) if largest > MIN_NOISE_RATIO else (1.0,)


def _optimize_racks(model: BreakModel, racks: list[FloatArray], steps: int) -> list[BreakSample]:
    """Optimize all racks that can be simulated, the best one first."""
    optimized = [sample for rack in racks if (sample := _optimize_rack(model, rack, steps)) is not None]
    return sorted(optimized, key=lambda one: one.cost)


def _hop_basins(
    model: BreakModel, best: list[BreakSample], sigma: FloatArray, times: int, rng: np.random.Generator
) -> list[BreakSample]:
    """Perturb and optimize the best samples, and return the best of all."""
    count, idle_hops = len(best), 0
    for _ in range(times):
        one = best[min(int(rng.exponential()), len(best) - 1)]
        size = 10 ** rng.uniform(*_HOP_POWERS)
        rack = model.make_feasible(one.parameters + size * sigma * rng.normal(size=len(sigma)))
        other = _optimize_rack(model, rack, OPTIMIZATION_STEPS)
        if other is None:
            continue
        idle_hops = 0 if other.cost < best[0].cost - _MIN_HOP_GAIN else idle_hops + 1
        best = sorted([*best, other], key=lambda one: one.cost)[:count]
        if idle_hops >= MAX_IDLE_HOPS:
            break
    return best


def _posterior_axes(model: BreakModel, best: BreakSample) -> FloatArray:
    """Return directions (P, P), one a column, in which the parameters err by one standard deviation each."""
    weight, _ = model.huber_weights(best.residual)
    jacobian = model.evaluate_jacobian(best.parameters, best.run) * np.sqrt(weight)[:, None]
    normal = jacobian.T @ jacobian
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), MIN_INFORMATION))
    values, axes = np.linalg.eigh(normal * scale * scale[:, None])
    spread: FloatArray = scale[:, None] * axes / np.sqrt(np.maximum(values, _RIDGE))
    return spread


def _sample_around(
    model: BreakModel, best: BreakSample, axes: FloatArray, misfit: float, rng: np.random.Generator
) -> list[tuple[BreakSample, float]]:
    """Draw samples around the best along its `axes` (P, P), each with its relative probability."""
    draws = []
    for _ in range(POSTERIOR_DRAWS):
        draw = rng.normal(size=len(axes))
        other = _simulate_sample(model, model.make_feasible(best.parameters + axes @ draw))
        if other is not None:
            excess = (other.cost - best.cost) / misfit - float(draw @ draw)
            draws.append((other, float(np.exp(-0.5 * max(excess, 0.0)))))
    return [(one, share) for one, share in draws if share > np.exp(-0.5 * MAX_CHI2_DISTANCE)]


def _simulate_sample(model: BreakModel, parameters: FloatArray) -> BreakSample | None:
    """Simulate these parameters; None if impossible."""
    try:
        residual, run = model.evaluate_residuals(parameters)
    except ArithmeticError:
        return None
    cost = model.huber_weights(residual)[1]
    return BreakSample(parameters, run, residual, cost) if np.isfinite(cost) else None


def _optimize_rack(model: BreakModel, parameters: FloatArray, steps: int) -> BreakSample | None:
    """Optimize the parameters by damped least squares; None where they cannot be simulated."""
    first = _simulate_sample(model, parameters)
    if first is None:
        return None

    def move(current: BreakSample, step: FloatArray) -> tuple[BreakSample, float] | None:
        if not np.all(np.isfinite(step)):
            return None
        trial = _simulate_sample(model, model.clip_to_bounds(current.parameters + step))
        return None if trial is None else (trial, trial.cost)

    return minimize_cost(
        first,
        first.cost,
        lambda current: _linearize_sample(model, current),
        solve_normal_equations,
        move,
        replace(_SEARCH, iterations=steps),
    ).point


def _linearize_sample(model: BreakModel, sample: BreakSample) -> NormalEquations | None:
    """Build the normal equations; None where the derivatives are not usable: a grazing contact, or NaN."""
    weight, _ = model.huber_weights(sample.residual)
    jacobian = model.evaluate_jacobian(sample.parameters, sample.run)
    if not np.abs(jacobian).max() < _MAX_JACOBIAN:
        return None
    return NormalEquations(jacobian.T @ (jacobian * weight[:, None]), jacobian.T @ (weight * sample.residual), _RIDGE)


# Ball radii that the incoming ball would go on without any contact: then the break is over.
LULL_RADII = 6.0
# m/s of closing; slower contacts change nothing.
MIN_SPEED = 0.02
# Least weighted share of the samples with a contact that is listed.
MIN_PROBABILITY = 0.5
# Share of contacts common to all samples that were true on breaks simulated by other code; see
# `benchmarks/tracking/breaks.py`.
MAX_PROBABILITY = 0.96
# s: balls in contact for a third of a millisecond do not touch at one moment.
MIN_TIME_SIGMA = 1e-4
# m, and shares of the speed of a ball: errors of the contact laws.
PLACE_SIGMA, SPEED_SIGMA, SLIP_SIGMA = 1e-4, 0.01, 0.03
# s after a contact, when the balls have separated.
TIME_EPSILON = 1e-9


def summarize_break(ensemble: BreakEnsemble) -> SimulatedBreak:
    """Summarize the contacts from the first to the last before a lull, and the states in which balls leave.

    Args:
        ensemble: Posterior samples of a break.

    Returns:
        The best sample, with the spread of the others.
    """
    break_shot, best = ensemble.break_shot, ensemble.samples[0].run
    rows = _list_ball_contacts(best)
    last = _break_end(break_shot, rows)
    rows = rows[rows[:, EVENT_TIME] <= last]
    others = [_list_ball_contacts(one.run) for one in ensemble.samples]
    directions = BreakModel(break_shot, break_shot.end).state_directions(ensemble.samples[0].parameters)
    contact_summaries = [_summarize_contact(ensemble, directions, others, rows, k) for k in range(len(rows))]
    exits = []
    for number in range(len(break_shot.balls)):
        mine = rows[(rows[:, EVENT_FIRST] == number) | (rows[:, EVENT_SECOND] == number), EVENT_TIME]
        if len(mine):
            exits.append(_summarize_exit(ensemble, directions, number, float(mine[0]), float(mine[-1])))
    return SimulatedBreak(
        break_shot.balls, break_shot.start, break_shot.hit, break_shot.interval,
        tuple(contact for contact in contact_summaries if contact.probability > MIN_PROBABILITY), tuple(exits),
        best.to_trajectory(),
    )  # fmt: skip


def _list_ball_contacts(run: SimulatedShot) -> FloatArray:
    """List the engine's contacts of two balls that approach fast enough."""
    events = run.contacts
    return np.asarray(events[(events[:, EVENT_KIND] == BALL) & (events[:, EVENT_SPEED] > MIN_SPEED)])


def _break_end(break_shot: BreakShot, contacts: FloatArray) -> float:
    """Return the time of the last contact before a lull, s of the simulation; at least a frame shows its result."""
    lull = max(break_shot.interval, LULL_RADII * break_shot.table.ball_radius / break_shot.speed)
    latest = break_shot.end - break_shot.start - 1.5 * break_shot.interval
    times = contacts[contacts[:, EVENT_TIME] <= latest, EVENT_TIME]
    if not len(times):
        return 0.0
    pause = np.flatnonzero(np.diff(times) > lull)
    return float(times[pause[0]] if len(pause) else times[-1])


def _summarize_contact(
    ensemble: BreakEnsemble, directions: FloatArray, others: list[FloatArray], contacts: FloatArray, k: int
) -> BreakContact:
    """Summarize contact k of the best sample; others share it where the same balls meet as often, about then."""
    break_shot, best = ensemble.break_shot, ensemble.samples[0].run
    row = contacts[k]
    a, b, t = int(row[EVENT_FIRST]), int(row[EVENT_SECOND]), float(row[EVENT_TIME])
    mine = np.flatnonzero(_is_same_pair(contacts, a, b))
    occurrence = int(np.searchsorted(mine, k))
    moments = np.full(len(others), np.nan)
    for m, other in enumerate(others):
        other_times = other[_is_same_pair(other, a, b), EVENT_TIME]
        if occurrence < len(other_times) and abs(other_times[occurrence] - t) < break_shot.interval:
            moments[m] = other_times[occurrence]
    is_shared = np.isfinite(moments)
    probability = float(ensemble.weight[is_shared].sum())
    scatter = np.sqrt(ensemble.weight[is_shared] / probability @ (moments[is_shared] - t) ** 2)
    sigma = max(float(np.hypot(scatter, _contact_time_sigma(ensemble, directions, a, b, t))), MIN_TIME_SIGMA)
    return BreakContact(
        break_shot.start + t, sigma, break_shot.balls[a], break_shot.balls[b], best.states_at(t)[a, :2],
        float(row[EVENT_SPEED]), MAX_PROBABILITY * probability,
    )  # fmt: skip


def _is_same_pair(contacts: FloatArray, a: int, b: int) -> NDArray[np.bool_]:
    """Mark the contacts of balls a and b."""
    one, two = contacts[:, EVENT_FIRST], contacts[:, EVENT_SECOND]
    return np.asarray(((one == a) & (two == b)) | ((one == b) & (two == a)))


def _summarize_exit(
    ensemble: BreakEnsemble, directions: FloatArray, number: int, first: float, last: float
) -> BreakExit:
    """Summarize the state in which a ball leaves the break."""
    break_shot = ensemble.break_shot
    arrival, arrival_covariance = _state_with_covariance(ensemble, directions, number, first - TIME_EPSILON)
    state, covariance = _state_with_covariance(ensemble, directions, number, last + TIME_EPSILON)
    return BreakExit(
        break_shot.balls[number], break_shot.start + first, break_shot.start + last, state, covariance,
        arrival[:2], arrival_covariance[:2, :2],
    )  # fmt: skip


def _state_with_covariance(
    ensemble: BreakEnsemble, directions: FloatArray, number: int, t: float
) -> tuple[FloatArray, FloatArray]:
    """Return place, velocity and slip (6,) of a ball at t, s of the simulation, and their covariance (6, 6).

    It includes the errors of the parameters, the spread of other samples, and errors of the contact laws.
    """
    states = np.array(
        [convert_to_starts(one.run.states_at(t), one.run.balls.radius)[number, :6] for one in ensemble.samples]
    )
    (jacobian,), other = _state_derivatives(ensemble, directions, (number,), t), states - states[0]
    speed = float(np.hypot(*states[0, 2:4]))
    floor = np.repeat([PLACE_SIGMA, SPEED_SIGMA * speed + MIN_SPEED, SLIP_SIGMA * speed + MIN_SPEED], 2)
    spread = jacobian @ ensemble.covariance @ jacobian.T + (other.T * ensemble.weight) @ other
    return states[0], spread + np.diag(floor**2)


def _state_derivatives(
    ensemble: BreakEnsemble, directions: FloatArray, numbers: tuple[int, ...], t: float
) -> FloatArray:
    """Return derivatives (K, 6, P) of the states of K balls at t, s of the simulation, by the best parameters.

    `directions` are those of `BreakModel.state_directions`.
    """
    run, chosen = ensemble.samples[0].run, list(numbers)
    place = np.full((1, len(ensemble.break_shot.balls)), -1)
    place[0, chosen] = np.arange(len(chosen))
    derivatives = run.directional_derivatives(np.array([t]), place, directions, STATE_SIZE)
    return convert_to_starts(derivatives.transpose(2, 0, 1), run.balls.radius[chosen]).transpose(1, 2, 0)[:, :6]


def _contact_time_sigma(ensemble: BreakEnsemble, directions: FloatArray, a: int, b: int, t: float) -> float:
    """Return the effect of parameter errors on the time of a contact, s: change of the gap over closing speed."""
    before = t - TIME_EPSILON
    states = convert_to_starts(ensemble.samples[0].run.states_at(before), ensemble.samples[0].run.balls.radius)
    separation = states[b, :2] - states[a, :2]
    line = separation / np.hypot(*separation)
    closing = max(float((states[a, 2:4] - states[b, 2:4]) @ line), MIN_SPEED)
    one, two = _state_derivatives(ensemble, directions, (a, b), before)
    gap = line @ (two[:2] - one[:2])
    return float(np.hypot(np.sqrt(max(gap @ ensemble.covariance @ gap, 0.0)), PLACE_SIGMA)) / closing
