"""Which effects are missing: signatures propose, joint refits decide, evidence is penalised for what was tried.

Effects are added while the data ask for one, taken away again where they turn out not to be needed, and exchanged for
others; a choice between published forms counts as an effect without a parameter. Every hypothesis ever fitted keeps
its evidence (Laplace's approximation, divided by the lack of fit), from which probabilities follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import combinations
from math import comb, log

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from diagnosis.fitting import GLANCE, USUAL, Fitted, Question, Told, fit, look
from diagnosis.growing import sought_anew
from diagnosis.signatures import Signatures, signatures

Floats = NDArray[np.float64]

SIGNIFICANT = 0.01
"""chance to add any effect where none is missing."""
TRIED = 4
"""hypotheses that are refitted at every step."""
MOST = 3
"""effects missing at once."""
_ONLY_TOGETHER = 1.5
"""times what the best single effect promises, from which two are tried at once; 20 more are beyond chance."""
_CLEAR = 50.0
"""chi2 from which a hypothesis explains something."""
_HOPELESS = 0.25
"""share of what the best hypothesis explains that another one must explain at a glance to be fitted to the end."""
_REFUTED = 40.0
"""log evidence from which a hypothesis stays refuted on longer windows, which tell more."""
_WORTH = 6.0
"""chi2 that an effect beside others must promise to be refitted: half of what it would need to be adopted."""
_ORDERS = float(np.log(1e4))
"""a missing effect is as likely to be of any order of magnitude, from the natural strength to a ten-thousandth."""


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
    base: Hypothesis
    alone: Fitted
    """what the simulator has, on windows as long as it allows by itself; those of `base` may be longer."""
    tried: dict[frozenset[str], Hypothesis] = field(default_factory=dict)
    told: dict[frozenset[str], Told] = field(default_factory=dict)
    """what the data say of all parameters at the fits looked at."""

    def __post_init__(self) -> None:
        self.tried[self.base.names] = self.base

    @property
    def choices(self) -> tuple[str, ...]:
        """All effects and forms that may be missing."""
        return (*self.question.candidates, *(choice.name for choice in self.question.scene.alternatives))

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

    def _known(self, one: Hypothesis) -> tuple[Floats, float]:
        """Standard deviations of what was known of the free parameters, and what it costs to have chosen them.

        A weak effect is no less likely than one of natural strength: the prior of each missing effect is as wide as the
        strength that was found, which costs as much as there are orders of magnitude to choose from.
        """
        fitted, question = one.fitted, self.question
        known = np.array([prior.sigma for prior in question.priors])
        error = np.zeros(len(known))
        error[fitted.free] = fitted.shooting.sigma
        cost = 0.0
        for name in fitted.names:
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


def search(question: Question, base: Fitted, longer: Callable[[Fitted], Fitted]) -> Search:
    """Try larger hypotheses, one effect more at a time, until nothing more is asked for; `longer` gives a fit windows
    as long as its hypothesis allows, on which the search then goes on."""
    state = Search(question, Hypothesis(frozenset(), base), alone=base)
    now = state.base
    while now.size < MOST:
        larger = _larger(state, now)
        if larger is None:
            break
        now = _exchanged(state, larger)
        further = longer(now.fitted)
        if len(further.pieces) < len(now.fitted.pieces):
            now = Hypothesis(now.names, further)
            state = _taken_up(state, now)
    return state


def _taken_up(former: Search, best: Hypothesis) -> Search:
    """The search on the longer windows that the best hypothesis allows: with those that were near it, each from its own
    strengths."""
    question, fitted = former.question, best.fitted

    def longer(one: Hypothesis) -> Hypothesis:
        own, refuted = one.fitted, former.weigh(former.best()) - former.weigh(one) > _REFUTED
        options = GLANCE if refuted else USUAL
        return Hypothesis(
            one.names, fit(question, fitted.pieces, own.names, own.forms, own.shared, fitted.starts, options)
        )

    state = Search(question, longer(former.base), alone=former.alone)
    state.tried[best.names] = best
    rivals = sorted(former.tried.values(), key=former.weigh, reverse=True)[: TRIED + 1]
    near = [one for one in rivals if former.weigh(former.best()) - former.weigh(one) < _REFUTED]
    near = [one for one in near if not one.names > best.names]  # what more is missing is asked anew
    for one in (*near, *(one for one in former.tried.values() if one.names < best.names)):
        if one.names not in state.tried:
            state.tried[one.names] = longer(one)
    return state


def _larger(state: Search, now: Hypothesis) -> Hypothesis | None:
    """The best hypothesis of one effect more, where that one is needed; else the best pair tried: of two effects that
    do as much, neither alone explains more than it leaves."""
    for names in _proposals(state, now):
        _try(state, names, now)
    for size in (now.size + 1, now.size + 2):
        more = [one for one in state.tried.values() if one.size == size]
        better = max(more, key=state.weigh, default=now)
        if more and state.total(size) > state.total(now.size) and needed(state, better):
            return better
    return None


def adopted(state: Search) -> Hypothesis:
    """Of the most probable number of effects, the hypothesis of greatest evidence in which every effect is needed; of
    fewer effects where there is none."""
    chosen = (_best_needed(state, size) for size in range(state.most(), 0, -1))
    return next((one for one in chosen if one is not None), state.base)


def _best_needed(state: Search, size: int) -> Hypothesis | None:
    """Of so many effects, the hypothesis of greatest evidence in which every one is needed."""
    alike = sorted((one for one in state.tried.values() if one.size == size), key=state.weigh, reverse=True)
    return next((one for one in alike if needed(state, one)), None)


def needed(state: Search, one: Hypothesis) -> bool:
    """Whether leaving out any of its effects costs more than chance among as many choices explains, and not less than
    what stays unexplained: a small effect beside a large misfit only stands in for it."""
    return all(
        chance(state, one, name) < SIGNIFICANT and lacking(state, one, name).cost - one.fitted.cost >= one.fitted.excess
        for name in one.names
    )


def lacking(state: Search, one: Hypothesis, name: str) -> Fitted:
    """The fit of a hypothesis that lacks one of its effects."""
    return _try(state, one.names - {name}, one).fitted


def chance(state: Search, one: Hypothesis, name: str) -> float:
    """Probability that adding the best of all choices to the others gains as much without cause (Sidak 1967)."""
    without = lacking(state, one, name)
    gain = (without.cost - one.fitted.cost) / max(one.fitted.lack, 1.0)
    more = max(int(one.fitted.free.sum() - without.free.sum()), 1)
    single = float(chi2.sf(max(gain, 0.0), more))
    return -float(np.expm1(len(state.choices) * np.log1p(-min(single, 1 - 1e-16))))


def _proposals(state: Search, now: Hypothesis) -> list[frozenset[str]]:
    """The next larger hypotheses that signatures rank first, other published forms, and from nothing also a pair."""
    found = _signatures(state, now)
    gains = {name: _promise(state, found, (name,)) for name in state.question.candidates if name not in now.names}
    first = sorted(gains, key=lambda name: gains[name], reverse=True)[:TRIED]
    first = [name for name in first if gains[name] > _WORTH or not now.names]
    forms = [choice.name for choice in state.question.scene.alternatives if choice.name not in now.names]
    forms = [] if now.names and now.fitted.excess == 0 else forms  # effects that leave noise alone stand for the form
    proposals = [now.names | {name} for name in (*first, *forms)]
    if not now.names:
        pairs = sorted(combinations(gains, 2), key=lambda two: _promise(state, found, two), reverse=True)
        proposals += [frozenset(two) for two in pairs[:1] if _beats(state, found, two, gains)]
    return proposals


def _beats(state: Search, found: Signatures, two: tuple[str, ...], gains: dict[str, float]) -> bool:
    """Whether a pair promises so much more than the best single effect that neither would be found alone."""
    return _promise(state, found, two) > _ONLY_TOGETHER * max(gains.values()) + 20.0


def _signatures(state: Search, now: Hypothesis) -> Signatures:
    if now.names not in state.told:
        state.told[now.names] = look(state.question, now.fitted).told
    return signatures(state.question, state.told[now.names], now.fitted.free)


def _promise(state: Search, found: Signatures, names: tuple[str, ...]) -> float:
    """chi2 that effects gain to first order, less what so many parameters gain by chance."""
    mask = state.question.mask(names)
    return found.gain(mask) - 2.0 * int(mask.sum())


def _try(state: Search, names: frozenset[str], near: Hypothesis) -> Hypothesis:
    """Fit a hypothesis, from the fit of one that is near."""
    known = state.tried.get(names)
    if known is not None:
        return known
    question = state.question
    effects = effects_of(question, names)
    found = min(_starting_from(state, names, effects, near), key=lambda fitted: fitted.cost)
    state.tried[names] = Hypothesis(names, found)
    return state.tried[names]


def effects_of(question: Question, names: frozenset[str]) -> tuple[str, ...]:
    """The effects that a hypothesis adds: those it names, and those that another published form brings."""
    brought = {name for one in question.scene.alternatives if one.name in names for name in one.brings}
    return tuple(name for name in question.candidates if name in names | brought)


def _starting_from(
    state: Search, names: frozenset[str], effects: tuple[str, ...], near: Hypothesis
) -> Iterator[Fitted]:
    """The fit from the strengths that signatures promise; per form where forms may differ from the assumed ones."""
    question = state.question
    fresh = question.mask(effects) & ~near.fitted.free
    guess = near.fitted.shared.copy()
    if fresh.any():
        guess[fresh] += _signatures(state, near).step(fresh)
    best = min(one.fitted.cost for one in state.tried.values())
    for forms in _forms(question, names):
        found = fit(question, near.fitted.pieces, effects, forms, guess, near.fitted.starts, GLANCE)
        holds = near.names <= names and forms == near.fitted.forms
        if holds and found.cost > near.fitted.cost:  # a long step took some windows to wrong paths
            found = fit(question, found.pieces, effects, forms, near.fitted.shared, near.fitted.starts, GLANCE)
        yield found
        explained = near.fitted.cost - best
        if explained > _CLEAR and near.fitted.cost - found.cost < _HOPELESS * explained:
            continue
        found = fit(question, found.pieces, effects, forms, found.shared, found.starts)
        yield found
        if found.cost > near.fitted.cost:
            yield sought_anew(question, found)


def _forms(question: Question, names: frozenset[str]) -> list[tuple[str, ...]]:
    """The published forms to try: the assumed ones, but all others where the choice itself is under suspicion."""
    found: list[tuple[str, ...]] = [()]
    for choice in question.scene.alternatives:
        others = [form for form in choice.forms if form != choice.assumed] if choice.name in names else [choice.assumed]
        found = [(*forms, form) for forms in found for form in others]
    return found


def _exchanged(state: Search, now: Hypothesis) -> Hypothesis:
    """The best of a hypothesis and those in which one of its effects gave way to a near rival.

    Rivals are fitted on windows that the smaller hypotheses allow too: on those that only the right one allows, a wrong
    one follows wrong paths, at great cost, and nothing is learnt from how much it leaves.
    """
    for name in now.names if now.size > 1 else ():
        rest = _try(state, now.names - {name}, now)
        found = _signatures(state, rest)
        rivals = [other for other in state.question.candidates if other not in now.names]
        rivals.sort(key=lambda other: _promise(state, found, (other,)), reverse=True)
        for other in rivals[:2]:
            _try(state, rest.names | {other}, rest)
    return _best_needed(state, now.size) or now
