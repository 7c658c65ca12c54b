"""Fits of one scene with some effects active, and the information that shots hold on every parameter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.shot_preparation import NoiseEstimate, WhitenedModel, build_noise_chain
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene, effect_parameter_mask, neutral_values
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, ShootingOptions, fit_windows
from models.estimation.multiple_shooting.shooting_problem import (
    Iterate,
    ShootingProblem,
    build_problem,
    linearize_chains,
    simulate_chains,
)
from models.estimation.multiple_shooting.shooting_windows import (
    ShootingModel,
    fix_parameters,
    is_lost,
    simulate_ahead,
    simulate_window,
)
from models.estimation.multiple_shooting.state_elimination import ChainBlock
from models.numerics.executor import SERIAL, Executor
from models.numerics.least_squares import solve_damped
from models.physics.effect import Prior

# Iteration limits of a fit that is compared with others.
FULL_FIT = ShootingOptions(iterations=25, shot_iterations=10)
# The same, with `retry_guesses` from all initial guesses of every shot.
ALL_GUESSES_FIT = replace(FULL_FIT, tries_all_guesses=True)
# Iteration limits of a first attempt, which decides whether a full fit is worthwhile.
COARSE_FIT = ShootingOptions(iterations=5, shot_iterations=3)
# Range of the cost per value that noise explains: its variance is known to some per cent; states absorb a few more.
NOISE_COST_LIMITS = 0.9, 1.15
# chi2 from which one fit of a hypothesis is better than another.
MIN_IMPROVEMENT = 1.0
# Factor on the sigma of priors of the simulator's effects: users know them less well than the literature does.
_SIMULATOR_PRIOR_FACTOR = 3.0


@dataclass(frozen=True, slots=True)
class DiagnosisProblem:
    """Scene, priors and noise: everything that stays the same while hypotheses are compared."""

    scene: GapScene
    priors: tuple[Prior, ...]
    """(P,) priors of all parameters, none of them relative, so that an effect may be absent."""
    natural: FloatArray
    """(P,) values from the literature; neutral where an effect may have either sign or any size."""
    noise: NoiseEstimate
    """Noise of the recordings."""
    executor: Executor = SERIAL
    """Distributes shots over processes."""

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects that the simulator may lack."""
        causes = (e.name for e in self.scene.effects if e.kind in ("physics", "observation"))
        return tuple(name for name in causes if name not in self.scene.simulator_effects)

    @property
    def probes(self) -> tuple[str, ...]:
        """Generic force fields; no cause is named after them."""
        return tuple(e.name for e in self.scene.effects if e.kind == "probe")

    def fit_options(self, options: ShootingOptions) -> ShootingOptions:
        """Return iteration limits with what the scene says of its paths and of the precision that a fit needs."""
        return replace(options, is_smooth=self.scene.is_smooth, least_gain=self.scene.least_gain)

    @property
    def simulator_forms(self) -> tuple[str, ...]:
        """The form of each contact model that the simulator has."""
        return tuple(choice.simulator_form for choice in self.scene.alternatives)

    def neutral(self, forms: tuple[str, ...]) -> FloatArray:
        """Return the values (P,) of all parameters with every effect absent, under these contact models."""
        return neutral_values(self.scene, forms)

    def mask(self, names: tuple[str, ...]) -> BoolArray:
        """Return a mask (P,) of the parameters of the named effects."""
        return effect_parameter_mask(self.scene, names)

    def clip_to_bounds(self, values: FloatArray) -> FloatArray:
        """Limit parameter values (P,) to the bounds of their priors, outside which a scene may not exist."""
        low, high = np.transpose([prior.bounds for prior in self.priors])
        return np.asarray(np.clip(values, low, high))


def build_diagnosis_problem(scene: GapScene, noise: NoiseEstimate, executor: Executor = SERIAL) -> DiagnosisProblem:
    """Build the problem of a scene, with priors in which an absent effect is as likely as one of usual strength.

    Args:
        scene: Scene with a catalogue of effects.
        noise: Noise of the recordings.
        executor: Distributes shots over processes; it does not change results.

    Returns:
        The problem.
    """
    priors = []
    usual = [(effect.name, prior) for effect in scene.effects for prior in effect.parameters]
    for (name, prior), neutral in zip(usual, neutral_values(scene).tolist(), strict=True):
        spread = prior.sigma * (abs(prior.value) if prior.relative else 1.0)
        low, high = min(prior.bounds[0], neutral), max(prior.bounds[1], neutral)
        is_simulated = name in scene.simulator_effects
        value = prior.value if is_simulated else neutral
        sigma = spread * _SIMULATOR_PRIOR_FACTOR if is_simulated else float(np.hypot(spread, prior.value - neutral))
        priors.append(Prior(f"{name}.{prior.name}", prior.unit, value, sigma, False, (low, high)))
    natural = np.array([prior.value for _, prior in usual])
    return DiagnosisProblem(scene, tuple(priors), natural, noise, executor)


@dataclass(frozen=True, slots=True)
class EffectFit:
    """A scene fitted to segments of recordings with some effects active."""

    segments: tuple[Recording, ...]
    names: tuple[str, ...]
    """Effects beyond those of the simulator."""
    forms: tuple[str, ...]
    """One form per choice between contact models."""
    free: BoolArray
    """(P,) mask of the fitted parameters."""
    shared: FloatArray
    """(P,) values of all parameters, neutral where an effect is absent."""
    shooting: ShootingFit
    """The multiple-shooting fit of the free parameters."""

    @property
    def starts(self) -> tuple[FloatArray, ...]:
        """Start state (S,) of each window."""
        return self.shooting.starts

    @property
    def noise_start_covariances(self) -> tuple[FloatArray, ...]:
        """Covariance (S, S) of each start state from the noise of the observations alone, whatever the lack of fit."""
        return tuple(one / self.shooting.inflation for one in self.shooting.start_covariances)

    @property
    def cost(self) -> float:
        """Robust chi2 of the residuals and priors."""
        return self.shooting.cost

    @property
    def value_count(self) -> int:
        """Number of observed coordinates."""
        return sum(int(segment.is_observed.sum()) * segment.positions.shape[2] for segment in self.segments)

    @property
    def systematic_cost(self) -> float:
        """Cost beyond noise of exactly the estimated size."""
        chi2 = self.shooting.chi2_per_dof
        return self.cost * (1.0 - 1.0 / chi2) if chi2 > 1.0 else 0.0

    @property
    def upper_excess_cost(self) -> float:
        """Cost beyond noise if its size was slightly overestimated."""
        return max(self.cost - NOISE_COST_LIMITS[0] * self.value_count, 0.0)

    @property
    def lower_excess_cost(self) -> float:
        """Cost beyond noise even if its size was slightly underestimated."""
        return max(self.cost - NOISE_COST_LIMITS[1] * self.value_count, 0.0)

    @property
    def lack_of_fit(self) -> float:
        """Factor >= 1 by which the variance of the residuals exceeds that of the noise."""
        return self.shooting.inflation


def build_window_model(
    problem: DiagnosisProblem, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None
) -> ShootingModel:
    """Build the scene's model of segments, with residuals whitened where the noise is correlated."""
    model = problem.scene.build_model(segments, forms, jacobian_mask)
    if problem.noise.correlation == 0:
        return model
    return WhitenedModel(model, tuple(build_noise_chain(segment, problem.noise.correlation) for segment in segments))


def fit_effects(
    problem: DiagnosisProblem,
    segments: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
    starts: tuple[FloatArray, ...] | None = None,
    options: ShootingOptions = FULL_FIT,
) -> EffectFit:
    """Fit the parameters of the simulator's effects and of further effects, with the start states of all windows.

    Args:
        problem: Scene and priors.
        segments: One window per segment.
        names: Effects beyond those of the simulator.
        forms: One form per choice between contact models; those of the simulator where not given.
        guess: (P,) initial guess of all parameters; the means of the priors where not given.
        starts: Start state (S,) of each window from an earlier fit.
        options: Iteration limits.

    Returns:
        The fit.
    """
    forms = problem.simulator_forms if forms is None else forms
    free = problem.mask((*problem.scene.simulator_effects, *names))
    values = np.array([prior.value for prior in problem.priors]) if guess is None else guess
    values = np.where(free, problem.clip_to_bounds(values), problem.neutral(forms))
    model = fix_parameters(build_window_model(problem, segments, forms, free), values, free, problem.priors)
    options = problem.fit_options(options)
    shooting = fit_windows(model, values[free], options, starts, executor=problem.executor)
    return EffectFit(segments, names, forms, free, model.fill_values(0, shooting.shared), shooting)


def can_simulate(problem: DiagnosisProblem, like: EffectFit, forms: tuple[str, ...], shared: FloatArray) -> bool:
    """Return whether the windows of a fit can be simulated with other parameters; some combinations are unphysical.

    Args:
        problem: Scene and priors.
        like: Fit with the windows and their start states.
        forms: One form per choice between contact models.
        shared: (P,) values of all parameters.

    Returns:
        True where all observations can be simulated.
    """
    return not any(is_lost(misfit).any() for misfit in simulate_misfits(problem, like, forms, shared))


def simulate_misfits(
    problem: DiagnosisProblem, like: EffectFit, forms: tuple[str, ...], shared: FloatArray
) -> Iterator[FloatArray]:
    """Simulate the windows of a fit with other parameters; see `can_simulate` for the arguments.

    Yields:
        Residuals (K, d) of each window, simulated as far as they are asked for where a model simulates each alone.
    """
    model = build_window_model(problem, like.segments, forms, np.zeros(len(shared), bool))
    count = len(like.segments)
    together = simulate_ahead(model, range(count), like.starts, [shared] * count, has_jacobians=False)
    for k, start in enumerate(like.starts):
        yield simulate_window(together, k, start, shared).residual


def fit_start_states(
    problem: DiagnosisProblem,
    segments: tuple[Recording, ...],
    like: EffectFit,
    starts: tuple[FloatArray, ...] | None = None,
    retry_guesses: bool = False,
) -> EffectFit:
    """Fit the start states of segments with all parameters fixed to those of another fit.

    Args:
        problem: Scene and priors.
        segments: One window per segment.
        like: Fit with the parameters and forms.
        starts: Start state (S,) of each window from an earlier fit.
        retry_guesses: With `starts`: also try the initial guesses of the windows, and keep the better ones.

    Returns:
        A fit without free parameters.
    """
    fixed = replace(like, free=np.zeros(len(problem.priors), bool))
    return refit_effects(problem, segments, fixed, starts, retry_guesses)


def refit_effects(
    problem: DiagnosisProblem,
    segments: tuple[Recording, ...],
    like: EffectFit,
    starts: tuple[FloatArray, ...] | None = None,
    retry_guesses: bool = False,
    options: ShootingOptions = FULL_FIT,
) -> EffectFit:
    """Refit the hypothesis of another fit to segments, from its parameters.

    Args:
        problem: Scene and priors.
        segments: One window per segment.
        like: Fit of the hypothesis; its free parameters are fitted again.
        starts: Start state (S,) of each window from an earlier fit.
        retry_guesses: With `starts`: also try the initial guesses of the windows, and keep the better ones.
        options: Iteration limits.

    Returns:
        The fit.
    """
    model = fix_parameters(
        build_window_model(problem, segments, like.forms, like.free), like.shared, like.free, problem.priors
    )
    options = problem.fit_options(options)
    shooting = fit_windows(model, like.shared[like.free], options, starts, retry_guesses, problem.executor)
    return EffectFit(segments, like.names, like.forms, like.free, model.fill_values(0, shooting.shared), shooting)


@dataclass(frozen=True, slots=True)
class ShotInformation:
    """Information that each of Q shots holds on all P parameters near a fit, with the start states marginalised."""

    shots: NDArray[np.int64]
    """(Q,) index of each shot."""
    information: FloatArray
    """(Q, P, P) information matrix of each shot."""
    score: FloatArray
    """(Q, P) gradient of the log-likelihood."""
    start_responses: tuple[FloatArray, ...]
    """(S, P) per window: derivative of the best start state by the parameters."""

    def shift_starts(self, starts: tuple[FloatArray, ...], step: FloatArray) -> tuple[FloatArray, ...]:
        """Shift the start states of all windows in response to a step (P,) of the parameters."""
        return tuple(start + answer @ step for start, answer in zip(starts, self.start_responses, strict=True))


@dataclass(frozen=True, slots=True)
class LinearizedFit:
    """A fit linearised by the start states and by every parameter of the catalogue."""

    point: Iterate
    shot_information: ShotInformation


def linearize_fit(problem: DiagnosisProblem, fitted: EffectFit) -> LinearizedFit:
    """Linearise the windows of a fit by all P parameters but those of generic laws, which no search considers.

    Args:
        problem: Scene and priors.
        fitted: Fit to linearise.

    Returns:
        The linearised windows and the information of each shot.
    """
    everything = np.ones(len(problem.priors), bool)
    model = fix_parameters(
        build_window_model(problem, fitted.segments, fitted.forms, ~problem.mask(problem.probes)),
        fitted.shared,
        everything,
        problem.priors,
    )
    shooting_problem = build_problem(model, problem.executor)
    point, blocks = linearize_chains(shooting_problem, simulate_chains(shooting_problem, fitted.starts, fitted.shared))
    chain_shots = [shooting_problem.windows[numbers[0]].shot for numbers in shooting_problem.chains]
    shots, place = np.unique(chain_shots, return_inverse=True)
    information = np.zeros((len(shots), len(everything), len(everything)))
    score = np.zeros((len(shots), len(everything)))
    for k, block in zip(place, blocks, strict=True):
        information[k] += block.schur_complement()
        score[k] -= block.shared_gradient - block.coupling.T @ solve_damped(block.states, block.gradient, 0.0)
    responses = _compute_start_responses(shooting_problem, point, blocks)
    return LinearizedFit(point, ShotInformation(shots, information, score, responses))


def _compute_start_responses(
    shooting_problem: ShootingProblem, point: Iterate, blocks: list[ChainBlock]
) -> tuple[FloatArray, ...]:
    """Compute the response (S, P) of the start state of each window, from the normal equations of its chain."""
    responses: list[FloatArray] = [np.empty((0, 0))] * len(shooting_problem.windows)
    for numbers, block in zip(shooting_problem.chains, blocks, strict=True):
        ends = np.cumsum([len(point.starts[k]) for k in numbers])
        parts = np.split(-solve_damped(block.states, block.coupling, 0.0), ends[:-1])
        for k, part in zip(numbers, parts, strict=True):
            responses[k] = part
    return tuple(responses)


def select_best_starts(
    problem: DiagnosisProblem,
    like: EffectFit,
    forms: tuple[str, ...],
    shared: FloatArray,
    candidates: list[tuple[FloatArray, ...]],
) -> tuple[FloatArray, ...]:
    """Select, chain by chain, the start states from which a simulation is closest to the observations.

    Args:
        problem: Scene and priors.
        like: Fit with the windows.
        forms: One form per choice between contact models.
        shared: (P,) values of all parameters.
        candidates: Alternatives; each has one start state (S,) per window.

    Returns:
        One start state (S,) per window.
    """
    none = np.zeros(len(shared), bool)
    model = fix_parameters(build_window_model(problem, like.segments, forms, none), shared, none, problem.priors)
    shooting_problem = build_problem(model, problem.executor)
    candidate_costs = [simulate_chains(shooting_problem, starts, shared[none]).costs[:-1] for starts in candidates]
    best = list(candidates[0])
    for numbers, costs in zip(shooting_problem.chains, np.transpose(candidate_costs), strict=True):
        for k in numbers:
            best[k] = candidates[int(np.argmin(costs))][k]
    return tuple(best)
