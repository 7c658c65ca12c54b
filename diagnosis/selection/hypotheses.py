"""Sets of missing effects, what has been fitted of them, and how much speaks for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import comb, log

import numpy as np

from diagnosis.fitting.hypothesis_fits import BETTER, Fitted, Question, Told, look
from diagnosis.selection.signatures import Signatures, signatures
from models.core.typing import FloatArray

_ORDERS = float(np.log(1e4))
"""a missing effect is as likely to be of any order of magnitude, from the natural strength to a ten-thousandth."""


Watch = Callable[[str, tuple[str, ...]], None]
"""Is told what is being done, and with which effects."""


def unwatched(doing: str, names: tuple[str, ...] = ()) -> None:
    """Nobody looks."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of missing effects, changed forms among them, and the fit with them."""

    names: frozenset[str]
    fitted: Fitted

    @property
    def size(self) -> int:
        return len(self.names)


@dataclass(slots=True)
class Search:
    """What has been fitted so far, on the same pieces throughout."""

    question: Question
    first: Hypothesis
    """what the simulator has, as the search began."""
    alone: Fitted
    """the same on windows as long as it allows by itself; those of `first` may be longer."""
    tried: dict[frozenset[str], Hypothesis] = field(default_factory=dict)
    told: dict[frozenset[str], Told] = field(default_factory=dict)
    """what the data say of all parameters at the fits looked at."""
    lent: dict[tuple[frozenset[str], frozenset[str]], float] = field(default_factory=dict)
    """per hypothesis, and other one that was begun from its starts too: what its fit cost then."""
    watch: Watch = unwatched

    def __post_init__(self) -> None:
        self.tried[self.first.names] = self.first

    @property
    def base(self) -> Hypothesis:
        """What the simulator has, as it fits best."""
        return self.tried[frozenset()]

    @property
    def choices(self) -> tuple[str, ...]:
        """All effects and forms that may be missing."""
        return (*self.question.candidates, *(choice.name for choice in self.question.scene.alternatives))

    def improve(self, one: Hypothesis, better: Fitted) -> Hypothesis:
        """Take a better fit of a hypothesis in place of its own; what was told at that no longer holds."""
        if better is one.fitted:
            return one
        self.told.pop(one.names, None)
        self.tried[one.names] = Hypothesis(one.names, better)
        return self.tried[one.names]

    def lend(self, one: Hypothesis, names: frozenset[str]) -> None:
        """Remember that another hypothesis was begun from the starts that this one has."""
        self.lent[one.names, names] = one.fitted.cost

    def has_lent(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether another hypothesis was begun from these starts, or from such as were hardly worse."""
        return self.lent.get((one.names, other.names), np.inf) - one.fitted.cost < BETTER

    def lack(self) -> float:
        """The least lack of fit that any hypothesis leaves: what the data scatter beyond the noise promised."""
        return min(one.fitted.lack for one in self.tried.values())

    def weigh(self, one: Hypothesis) -> float:
        """Log of evidence times prior: one effect is as likely as none, each further one halves that, and sets of as
        many effects share it alike."""
        fitted = one.fitted
        known, narrower = self._known(one)
        posterior = fitted.shooting.covariance / known / known[:, None] * (self.lack() / fitted.lack)
        width = float(np.linalg.slogdet(posterior)[1]) if len(known) else 0.0
        chosen = log(comb(len(self.choices), one.size)) + max(one.size - 1, 0) * log(2)
        return -0.5 * fitted.cost / self.lack() + 0.5 * width - narrower - chosen

    def _known(self, one: Hypothesis) -> tuple[FloatArray, float]:
        """Standard deviations of what was known of the free parameters, and what it costs to have chosen them.

        A weak effect is no less likely than one of natural strength: the prior of each missing effect is as wide as the
        strength that was found, which costs as much as there are orders of magnitude to choose from.
        """
        fitted, question = one.fitted, self.question
        known = np.array([prior.sigma for prior in question.priors])
        error = np.zeros(len(known))
        error[fitted.free] = fitted.shooting.sigma
        cost = 0.0
        for name in (one for one in fitted.names if one in question.candidates):
            own = question.mask((name,)) & fitted.free
            strength = (fitted.shared[own] - question.neutral[own]) / known[own]
            scale = min(float(np.sqrt(np.mean(np.maximum(strength**2, (error[own] / known[own]) ** 2)))), 1.0)
            cost += 0.5 * float(np.square(strength).sum()) * (1 / scale**2 - 1) + log(_ORDERS)
            known[own] *= scale
        return known[fitted.free], cost

    def best(self) -> Hypothesis:
        """The one of greatest evidence."""
        return max(self.tried.values(), key=self.weigh)

    def most(self) -> int:
        """How many effects are missing, most probably: alike ones share the evidence that something is missing."""
        sizes = {one.size for one in self.tried.values()}
        return max(sizes, key=self.total)

    def total(self, size: int) -> float:
        """Log of evidence times prior of all sets of so many effects."""
        return float(np.logaddexp.reduce([self.weigh(one) for one in self.tried.values() if one.size == size]))


def told_by(state: Search, now: Hypothesis) -> Told:
    """What the data say of all parameters at the fit of a hypothesis."""
    if now.names not in state.told:
        state.told[now.names] = look(state.question, now.fitted).told
    return state.told[now.names]


def signatures_of(state: Search, now: Hypothesis) -> Signatures:
    """Of all effects, once everything that a hypothesis leaves free is adjusted."""
    return signatures(state.question, told_by(state, now), now.fitted.free)
