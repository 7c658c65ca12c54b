"""Hypotheses (sets of missing effects), their fits, the signatures of further effects, and the evidence for each.

A signature is how an effect would show in these data after everything that a simulator adjusts has been adjusted. A
refit hides most of a missing effect: start states and the simulator's parameters absorb it. The derivative by a
parameter with those projected out is its signature. It gives the score test (Rao 1948,
doi:10.1017/S0305004100023987), the smallest detectable strength and, by correlations, which effects these data cannot
separate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import comb, log

import numpy as np

from diagnosis.fitting.hypothesis_fits import (
    MIN_IMPROVEMENT,
    DiagnosisProblem,
    EffectFit,
    ShotInformation,
    fit_effects,
    linearize_fit,
)
from models.core.typing import BoolArray, FloatArray
from models.numerics.least_squares import invert_semidefinite, solve_damped

# Correlation from which two effects cannot be separated.
INSEPARABLE_CORRELATION = 0.9
# Standard deviations from which a single parameter is detected.
DETECTION_SIGMAS = 3.0
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Signatures:
    """Information and score of all P parameters, free ones projected out; their rows and columns are 0."""

    information: FloatArray
    """(P, P) information of the data, without priors."""
    score: FloatArray
    """(P,)"""
    raw: FloatArray
    """(P,) information on each parameter before the free ones were projected out."""
    prior: FloatArray
    """(P,) 1/sigma^2 of the priors."""

    def gain(self, mask: BoolArray) -> float:
        """Return the chi2 gain of freeing the parameters in `mask`, to first order."""
        return float(self.score[mask] @ self.step(mask))

    def step(self, mask: BoolArray) -> FloatArray:
        """Return the step of the parameters in `mask` when they are freed."""
        here = self.information[np.ix_(mask, mask)] + np.diag(self.prior[mask])
        return solve_damped(here, self.score[mask], 0.0)

    def detectable_strengths(self, effect: BoolArray) -> FloatArray:
        """Return the smallest detectable strength (P,) of each parameter of an effect; infinite where there is none."""
        strengths = np.full(len(self.score), np.inf)
        identifiable = np.flatnonzero(effect & (np.diag(self.information) > 1e-6 * self.raw))
        if len(identifiable):
            inverse = invert_semidefinite(self.information[np.ix_(identifiable, identifiable)])
            strengths[identifiable] = DETECTION_SIGMAS * np.sqrt(np.diag(inverse))
        return strengths


def compute_signatures(
    problem: DiagnosisProblem, shot_information: ShotInformation, free: BoolArray, variance_factor: float = 1.0
) -> Signatures:
    """Compute the signatures of all parameters.

    Args:
        problem: Scene and priors.
        shot_information: Information of each shot.
        free: (P,) mask of the parameters that are projected out.
        variance_factor: Factor by which the variance of the data exceeds that of the noise.

    Returns:
        The signatures.
    """
    prior = np.array([1 / one.sigma**2 for one in problem.priors])
    information, score = (
        shot_information.information.sum(axis=0) / variance_factor,
        shot_information.score.sum(axis=0) / variance_factor,
    )
    raw = np.diag(information).copy()
    absorbed = absorb_by_free(problem, information, free, np.column_stack([information[free], score[free]]))
    left = information - absorbed[:, :-1]
    left[free] = left[:, free] = 0.0
    return Signatures((left + left.T) / 2, np.where(free, 0.0, score - absorbed[:, -1]), raw, prior)


def absorb_by_free(
    problem: DiagnosisProblem, information: FloatArray, free: BoolArray, gradients: FloatArray
) -> FloatArray:
    """Return the part of gradients by all parameters that the free ones absorb, within their priors.

    Args:
        problem: Scene and priors.
        information: (P, P) information of the data.
        free: (P,) mask of F free parameters.
        gradients: (F, K) gradients by the free parameters.

    Returns:
        (P, K) gradients by all parameters.
    """
    prior = np.array([1 / one.sigma**2 for one in problem.priors])
    inside = information[np.ix_(free, free)] + np.diag(prior[free])
    return np.asarray(information[free].T @ solve_damped(inside, gradients, 0.0))


def whitening_directions(effect_signatures: Signatures, mask: BoolArray) -> FloatArray:
    """Return directions (p, q) of an effect's parameters with orthonormal signatures."""
    here = effect_signatures.information[np.ix_(mask, mask)]
    scale = 1 / np.sqrt(np.maximum(effect_signatures.raw[mask], _TINY))
    sizes, axes = np.linalg.eigh(here * scale * scale[:, None])
    significant = sizes > 1e-8
    return np.asarray(scale[:, None] * axes[:, significant] / np.sqrt(sizes[significant]))


def direction_correlation(effect_signatures: Signatures, one: BoolArray, other: BoolArray) -> float:
    """Return the correlation of the step that the data require of one effect with the best step of another.

    Args:
        effect_signatures: Signatures with everything else projected out.
        one: (P,) mask of the parameters of the first effect.
        other: (P,) mask of the parameters of the second effect.

    Returns:
        Correlation between 0 and 1.
    """
    step = effect_signatures.step(one)
    size = float(step @ effect_signatures.information[np.ix_(one, one)] @ step)
    b = whitening_directions(effect_signatures, other)
    if size <= 0 or b.size == 0:
        return 0.0
    across = float(np.linalg.norm(b.T @ effect_signatures.information[np.ix_(other, one)] @ step))
    return min(across / float(np.sqrt(size)), 1.0)


# Log of the range of strengths: any order of magnitude from the natural strength to a ten-thousandth is as likely.
_LOG_STRENGTH_RANGE = float(np.log(1e4))

# Difference of log evidence from which a rival is refuted.
REFUTED_RIVAL_LOG_EVIDENCE = 3.0
# Steps of a search after those that are planned: usually one more round, and one on longer windows.
LATER_STEPS = 16


@dataclass(frozen=True, slots=True)
class SearchOutlook:
    """What a search has so far, and how far it is."""

    best: tuple[str, ...] | None = None
    """Effects of the best hypothesis so far, empty for the simulator alone; None before there is one to compare."""
    steps_done: int = 0
    steps_left: int = LATER_STEPS
    """Estimated number of further steps."""


# Receives a description of a step, the names of the effects that it concerns, and the outlook of the search.
ProgressCallback = Callable[[str, tuple[str, ...], SearchOutlook], None]


def ignore_progress(doing: str, names: tuple[str, ...], outlook: SearchOutlook) -> None:
    """Ignore a progress message.

    Args:
        doing: Description of the step.
        names: Effects that it concerns.
        outlook: What the search has so far.
    """


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of missing effects, including changed contact models, and the fit with them."""

    names: frozenset[str]
    fitted: EffectFit

    @property
    def size(self) -> int:
        """Number of effects."""
        return len(self.names)


@dataclass(slots=True)
class EffectSearch:
    """All hypotheses that have been fitted, on the same windows."""

    problem: DiagnosisProblem
    initial: Hypothesis
    """The simulator alone, at the start of the search."""
    simulator_fit: EffectFit
    """The simulator alone on windows that are as long as it allows; those of `initial` may be longer."""
    hypotheses: dict[frozenset[str], Hypothesis] = field(default_factory=dict)
    """Fitted hypotheses by their effects."""
    shot_information: dict[frozenset[str], ShotInformation] = field(default_factory=dict)
    """Information on all parameters at the linearised fits, by their effects."""
    shared_start_costs: dict[tuple[frozenset[str], frozenset[str]], float] = field(default_factory=dict)
    """Cost of a hypothesis (first) when another (second) was refitted from its starts."""
    generic_law_fits: dict[frozenset[str], tuple[EffectFit, EffectFit]] = field(default_factory=dict)
    """Fits of hypotheses, and the same with the generic laws beside their effects."""
    blocked_pairs: set[frozenset[str]] = field(default_factory=set)
    """Pairs of effects of which one was kept absent by its bounds beside the fitted strengths of the other."""
    on_progress: ProgressCallback = ignore_progress
    steps_done: int = 0
    """Number of steps that were reported."""
    steps_planned: int = LATER_STEPS
    """Estimated number of all steps."""

    def __post_init__(self) -> None:
        self.hypotheses[self.initial.names] = self.initial

    @property
    def base(self) -> Hypothesis:
        """The simulator alone, with its best fit."""
        return self.hypotheses[frozenset()]

    @property
    def choices(self) -> tuple[str, ...]:
        """All effects and contact models that may be missing."""
        return (*self.problem.candidates, *(choice.name for choice in self.problem.scene.alternatives))

    def plan_steps(self, count: int) -> None:
        """Plan a number of steps, after which `LATER_STEPS` more are expected."""
        self.steps_planned = self.steps_done + count + LATER_STEPS

    def report_step(self, doing: str, names: frozenset[str]) -> None:
        """Report that a step begins.

        Args:
            doing: Description of the step.
            names: Effects that it concerns.
        """
        best = tuple(sorted(self.select_best().names)) if len(self.hypotheses) > 1 else None
        left = max(self.steps_planned - self.steps_done, 1)
        self.on_progress(doing, tuple(sorted(names)), SearchOutlook(best, self.steps_done, left))
        self.steps_done += 1

    def replace_fit(self, one: Hypothesis, better: EffectFit) -> Hypothesis:
        """Replace the fit of a hypothesis by a better one, and forget its linearisation."""
        if better is one.fitted:
            return one
        self.shot_information.pop(one.names, None)
        self.hypotheses[one.names] = Hypothesis(one.names, better)
        return self.hypotheses[one.names]

    def generic_law_gain(self, one: Hypothesis) -> float:
        """Return the cost that generic laws explain beside the effects of a hypothesis, beyond what chance gives.

        They are fitted once for each of its fits.
        """
        fitted, free = one.fitted, int(self.problem.mask(self.problem.probes).sum())
        if one.names not in self.generic_law_fits or self.generic_law_fits[one.names][0] is not fitted:
            names = (*fitted.names, *self.problem.probes)
            with_laws = fit_effects(self.problem, fitted.segments, names, fitted.forms, fitted.shared, fitted.starts)
            self.generic_law_fits[one.names] = fitted, with_laws
        with_laws = self.generic_law_fits[one.names][1]
        return max(fitted.cost - with_laws.cost - free * with_laws.lack_of_fit, 0.0)

    def record_shared_starts(self, one: Hypothesis, names: frozenset[str]) -> None:
        """Record that another hypothesis was refitted from the starts of this one."""
        self.shared_start_costs[one.names, names] = one.fitted.cost

    def has_shared_starts(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Return whether another hypothesis was refitted from these starts, or from slightly worse ones."""
        return self.shared_start_costs.get((one.names, other.names), np.inf) - one.fitted.cost < MIN_IMPROVEMENT

    def smallest_lack_of_fit(self) -> float:
        """Return the smallest lack of fit of all hypotheses: the scatter beyond the estimated noise."""
        return min(one.fitted.lack_of_fit for one in self.hypotheses.values())

    def log_evidence(self, one: Hypothesis) -> float:
        """Return the log of evidence times prior of a hypothesis.

        One effect is as likely as none, each further one halves the prior, and all sets of a size share it equally.
        """
        fitted = one.fitted
        prior_sigmas, prior_cost = self._adapt_priors(one)
        posterior = (
            fitted.shooting.covariance
            / prior_sigmas
            / prior_sigmas[:, None]
            * (self.smallest_lack_of_fit() / fitted.lack_of_fit)
        )
        width = float(np.linalg.slogdet(posterior)[1]) if len(prior_sigmas) else 0.0
        chosen = log(comb(len(self.choices), one.size)) + max(one.size - 1, 0) * log(2)
        return -0.5 * fitted.cost / self.smallest_lack_of_fit() + 0.5 * width - prior_cost - chosen

    def _adapt_priors(self, one: Hypothesis) -> tuple[FloatArray, float]:
        """Return the prior sigmas (p,) of the free parameters, and the cost of adapting them to the fitted strengths.

        A weak effect is no less likely than one of natural strength: the prior of each missing effect is as wide as its
        fitted strength, which costs the log of the number of orders of magnitude to choose from.
        """
        fitted, problem = one.fitted, self.problem
        neutral = problem.neutral(fitted.forms)
        sigmas = np.array([prior.sigma for prior in problem.priors])
        error = np.zeros(len(sigmas))
        error[fitted.free] = fitted.shooting.sigma
        cost = 0.0
        for name in (one for one in fitted.names if one in problem.candidates):
            own = problem.mask((name,)) & fitted.free
            strength = (fitted.shared[own] - neutral[own]) / sigmas[own]
            scale = min(float(np.sqrt(np.mean(np.maximum(strength**2, (error[own] / sigmas[own]) ** 2)))), 1.0)
            cost += 0.5 * float(np.square(strength).sum()) * (1 / scale**2 - 1) + log(_LOG_STRENGTH_RANGE)
            sigmas[own] *= scale
        return sigmas[fitted.free], cost

    def select_best(self) -> Hypothesis:
        """Return the hypothesis of greatest evidence."""
        return max(self.hypotheses.values(), key=self.log_evidence)

    def most_probable_size(self) -> int:
        """Return the most probable number of missing effects.

        Similar effects share the evidence that one is missing.
        """
        sizes = {one.size for one in self.hypotheses.values()}
        return max(sizes, key=self.log_evidence_of_size)

    def log_evidence_of_size(self, size: int) -> float:
        """Return the log of evidence times prior of all hypotheses of a size."""
        return float(
            np.logaddexp.reduce([self.log_evidence(one) for one in self.hypotheses.values() if one.size == size])
        )


def get_shot_information(search: EffectSearch, now: Hypothesis) -> ShotInformation:
    """Return the information of all shots at the fit of a hypothesis, linearised once."""
    if now.names not in search.shot_information:
        search.shot_information[now.names] = linearize_fit(search.problem, now.fitted).shot_information
    return search.shot_information[now.names]


def compute_hypothesis_signatures(search: EffectSearch, now: Hypothesis) -> Signatures:
    """Compute the signatures of all effects with the free parameters of a hypothesis projected out."""
    return compute_signatures(search.problem, get_shot_information(search, now), now.fitted.free)
