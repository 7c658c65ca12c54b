"""Fits of one scene with some of its effects active, and what the data then say of every parameter of the catalogue."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.noise_whitening import Decorrelated, chain
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene, Recording, neutral_values, parameters_of
from models.estimation.multiple_shooting.fixed_parameters import Held
from models.estimation.multiple_shooting.normal_equations import glanced, sloped_everywhere
from models.estimation.multiple_shooting.shooting_fit import Shooting, ShootingOptions, shoot
from models.estimation.multiple_shooting.shooting_problem import Attempt, Problem, problem_of
from models.estimation.multiple_shooting.shooting_windows import Model, glance
from models.estimation.multiple_shooting.state_elimination import ShotBlock, solved
from models.numerics.executor import ALONE, Crew
from models.physics.effect import Prior

USUAL = ShootingOptions(iterations=25, settling=10)
GLANCE = ShootingOptions(iterations=5, settling=3)
"""of what is hardly worth it."""
_AT_LEAST, _AT_MOST = 0.9, 1.15
"""cost per observation that noise explains: its variance is known to some per cent, and states take up a few more."""
BETTER = 1.0
"""chi2 from which one fit is better than another of the same hypothesis."""
_WIDER = 3.0
"""factor on the priors of what the simulator already has: its users know it less well than the books."""


@dataclass(frozen=True, slots=True)
class Question:
    """What does not change while models are compared."""

    scene: GapScene
    priors: tuple[Prior, ...]
    """(P,) of all parameters, none of them relative, so that an effect may be absent."""
    neutral: FloatArray
    """(P,)"""
    natural: FloatArray
    """(P,) what the books say; neutral where an effect may be of either sign or of any size."""
    correlation: float
    """of the noise of neighbouring pictures."""
    crew: Crew = ALONE
    """who works through the shots."""

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects that the simulator may lack."""
        causes = (e.name for e in self.scene.effects if e.kind in ("physics", "observation"))
        return tuple(name for name in causes if name not in self.scene.assumed)

    @property
    def probes(self) -> tuple[str, ...]:
        """Generic fields, which no cause is named after."""
        return tuple(e.name for e in self.scene.effects if e.kind == "probe")

    @property
    def assumed_forms(self) -> tuple[str, ...]:
        return tuple(choice.assumed for choice in self.scene.alternatives)

    def mask(self, names: tuple[str, ...]) -> BoolArray:
        """(P,) the parameters of these effects."""
        return parameters_of(self.scene, names)


def question_of(scene: GapScene, correlation: float, crew: Crew = ALONE) -> Question:
    """Priors of the catalogue as the diagnosis uses them: an absent effect is as likely as one of usual strength."""
    priors = []
    for effect in scene.effects:
        for prior, neutral in zip(effect.parameters, effect.neutral, strict=True):
            spread = prior.sigma * (abs(prior.value) if prior.relative else 1.0)
            low, high = min(prior.bounds[0], neutral), max(prior.bounds[1], neutral)
            known = effect.name in scene.assumed
            value = prior.value if known else neutral
            sigma = spread * _WIDER if known else float(np.hypot(spread, prior.value - neutral))
            priors.append(Prior(f"{effect.name}.{prior.name}", prior.unit, value, sigma, False, (low, high)))
    natural = np.array([prior.value for effect in scene.effects for prior in effect.parameters])
    return Question(scene, tuple(priors), neutral_values(scene), natural, correlation, crew)


@dataclass(frozen=True, slots=True)
class Fitted:
    """A model fitted to pieces of recordings."""

    pieces: tuple[Recording, ...]
    names: tuple[str, ...]
    """effects added to those that the simulator has."""
    forms: tuple[str, ...]
    free: BoolArray
    """(P,)"""
    shared: FloatArray
    """(P,) all parameters, the neutral ones among them."""
    shooting: Shooting
    """of the free ones."""

    @property
    def starts(self) -> tuple[FloatArray, ...]:
        return self.shooting.starts

    @property
    def cost(self) -> float:
        return self.shooting.cost

    @property
    def observations(self) -> int:
        """Numbers that were seen."""
        return sum(int(piece.seen.sum()) * piece.places.shape[2] for piece in self.pieces)

    @property
    def unlike_noise(self) -> float:
        """Cost beyond noise of just the size that was estimated."""
        chi2 = self.shooting.chi2_per_dof
        return self.cost * (1.0 - 1.0 / chi2) if chi2 > 1.0 else 0.0

    @property
    def doubtful(self) -> float:
        """Cost that may be beyond noise, if its size were a little overestimated."""
        return max(self.cost - _AT_LEAST * self.observations, 0.0)

    @property
    def excess(self) -> float:
        """Cost beyond noise, even if its size were a little underestimated."""
        return max(self.cost - _AT_MOST * self.observations, 0.0)

    @property
    def lack(self) -> float:
        """>= 1: how much larger than the noise the residuals are, as a factor on variances."""
        return self.shooting.inflation


def model_of(
    question: Question, pieces: tuple[Recording, ...], forms: tuple[str, ...], wanted: BoolArray | None
) -> Model:
    """The scene's model, its misfits independent."""
    model = question.scene.model(pieces, forms, wanted)
    if question.correlation == 0:
        return model
    return Decorrelated(model, tuple(chain(piece, question.correlation) for piece in pieces))


def fit(
    question: Question,
    pieces: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
    starts: tuple[FloatArray, ...] | None = None,
    options: ShootingOptions = USUAL,
) -> Fitted:
    """Fit what the simulator has together with the effects `names`, from `guess` (P,) and from `starts` where given."""
    forms = question.assumed_forms if forms is None else forms
    free = question.mask((*question.scene.assumed, *names))
    values = np.where(free, [prior.value for prior in question.priors], question.neutral) if guess is None else guess
    values = np.where(free, _inside(question.priors, values), question.neutral)
    held = Held(model_of(question, pieces, forms, free), values, free, question.priors)
    found = shoot(held, values[free], options, starts, crew=question.crew)
    return Fitted(pieces, names, forms, free, held.whole(found.shared), found)


def allowed(question: Question, like: Fitted, forms: tuple[str, ...], shared: FloatArray) -> bool:
    """Whether the windows of a fit can be simulated with these numbers (P,): nature forbids some together."""
    model = model_of(question, like.pieces, forms, np.zeros(len(shared), bool))
    misfits = (glance(model, k, start, shared).misfit for k, start in enumerate(like.starts))
    return all(bool(np.isfinite(misfit).all()) for misfit in misfits)


def follow(
    question: Question,
    pieces: tuple[Recording, ...],
    like: Fitted,
    starts: tuple[FloatArray, ...] | None = None,
    anew: bool = False,
) -> Fitted:
    """Only the starts of other pieces fitted, all parameters kept."""
    fixed = replace(like, free=np.zeros(len(question.priors), bool))
    return again(question, pieces, fixed, starts, anew)


def again(
    question: Question,
    pieces: tuple[Recording, ...],
    like: Fitted,
    starts: tuple[FloatArray, ...] | None = None,
    anew: bool = False,
    options: ShootingOptions = USUAL,
) -> Fitted:
    """The same hypothesis on other pieces, from its parameters and from `starts` where given; `anew` also from what was
    seen there alone."""
    held = Held(model_of(question, pieces, like.forms, like.free), like.shared, like.free, question.priors)
    found = shoot(held, like.shared[like.free], options, starts, anew, question.crew)
    return Fitted(pieces, like.names, like.forms, like.free, held.whole(found.shared), found)


def _inside(priors: tuple[Prior, ...], values: FloatArray) -> FloatArray:
    low = np.array([prior.bounds[0] for prior in priors])
    high = np.array([prior.bounds[1] for prior in priors])
    return np.asarray(np.clip(values, low, high))


@dataclass(frozen=True, slots=True)
class Told:
    """What shots tell of all P parameters near a fit, their states left open: Q shots."""

    shots: NDArray[np.int64]
    """(Q,)"""
    information: FloatArray
    """(Q, P, P)"""
    score: FloatArray
    """(Q, P) slope of the log-likelihood."""
    answers: tuple[FloatArray, ...]
    """per window (S, P): how its start moves with each parameter, to stay with what was seen."""

    def answered(self, starts: tuple[FloatArray, ...], step: FloatArray) -> tuple[FloatArray, ...]:
        """Starts of all windows, moved as a step (P,) of the parameters asks."""
        return tuple(start + answer @ step for start, answer in zip(starts, self.answers, strict=True))


@dataclass(frozen=True, slots=True)
class Seen:
    """Simulations at a fit with the slopes by every parameter of the catalogue."""

    problem: Problem
    point: Attempt
    told: Told


def look(question: Question, fitted: Fitted) -> Seen:
    """The windows of a fit once more, with the slopes by all parameters."""
    everything = np.ones(len(question.priors), bool)
    model = Held(model_of(question, fitted.pieces, fitted.forms, None), fitted.shared, everything, question.priors)
    problem = problem_of(model, question.crew)
    point, blocks = sloped_everywhere(problem, glanced(problem, fitted.starts, fitted.shared))
    score = [-(b.shared_gradient - b.coupling.T @ solved(b.states, b.gradient, 0.0)) for b in blocks]
    information = np.stack([b.reduced() for b in blocks])
    return Seen(
        problem,
        point,
        Told(
            np.array(sorted({w.shot for w in problem.windows})),
            information,
            np.stack(score),
            _answers(problem, point, blocks),
        ),
    )


def _answers(problem: Problem, point: Attempt, blocks: list[ShotBlock]) -> tuple[FloatArray, ...]:
    """Per window (S, P), from the normal equations of its shot."""
    found: list[FloatArray] = [np.empty((0, 0))] * len(problem.windows)
    for numbers, block in zip(problem.shots, blocks, strict=True):
        ends = np.cumsum([len(point.starts[k]) for k in numbers])
        parts = np.split(-solved(block.states, block.coupling, 0.0), ends[:-1])
        for k, part in zip(numbers, parts, strict=True):
            found[k] = part
    return tuple(found)


def nearest(
    question: Question, like: Fitted, forms: tuple[str, ...], shared: FloatArray, offered: list[tuple[FloatArray, ...]]
) -> tuple[FloatArray, ...]:
    """Of all starts offered for the windows of a fit, shot by shot those from which a simulation with these numbers
    (P,) comes nearest to what was seen."""
    none = np.zeros(len(shared), bool)
    held = Held(model_of(question, like.pieces, forms, none), shared, none, question.priors)
    problem = problem_of(held, question.crew)
    tried = [glanced(problem, starts, shared[none]).costs[:-1] for starts in offered]
    found = list(offered[0])
    for numbers, costs in zip(problem.shots, np.transpose(tried), strict=True):
        for k in numbers:
            found[k] = offered[int(np.argmin(costs))][k]
    return tuple(found)
