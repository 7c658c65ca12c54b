"""How a hypothesis is fitted: from one that is near, from the strengths that signatures promise, or from the books."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.hypothesis_fits import GLANCE, Fitted, Question, allowed, fit, nearest
from diagnosis.fitting.window_growth import begun_like, sought_anew, straightened
from diagnosis.selection.hypotheses import Hypothesis, Search, signatures_of, told_by
from models.core.typing import FloatArray

CLEAR = 50.0
"""chi2 from which a hypothesis explains something."""
LEFT = 1.2
"""lack of fit from which something is left."""
_BEYOND_CHANCE = 20.0
"""chi2 that a detail must gain: chance gives one parameter as much once in a hundred thousand cases."""
_HOPELESS = 0.25
"""share of what the best hypothesis explains that another one must explain at a glance to be fitted to the end."""
_REFUTED = 3.0
"""times the cost of a hypothesis, from which no other starts alone can save one that was begun from it."""
_LITTLE = 0.5
"""of its natural strength, up to which an effect may have been imitated by hidden states: it is then begun from all of
it, with states from what is seen alone, for those that were fitted without it keep imitating it. So is another form
that leaves much."""


def tried(state: Search, names: frozenset[str], near: Hypothesis) -> Hypothesis:
    """Fit a hypothesis, from the fit of one that is near."""
    known = state.tried.get(names)
    if known is not None and not _astray(state, known, near):
        return known
    state.watch("trying", tuple(sorted(names)))
    question = state.question
    effects = effects_of(question, names)
    effects += tuple(one for one in details_of(question, names) if one in near.fitted.names and one not in effects)
    found = min(_starting_from(state, names, effects, near), key=lambda fitted: fitted.cost)
    if known is not None:
        state.lend(near, names)
        return state.improve(known, min(known.fitted, found, key=lambda fitted: fitted.cost))
    state.tried[names] = Hypothesis(names, found)
    return state.tried[names]


def _astray(state: Search, known: Hypothesis, near: Hypothesis) -> bool:
    """Whether a fit explains less than one of fewer effects, and was not begun from that: it has lost its way."""
    added = known.names - near.names
    nested = near.names < known.names and not any(one.name in added for one in state.question.scene.alternatives)
    alike = known.fitted.pieces is near.fitted.pieces and not state.has_lent(near, known)
    return nested and alike and known.fitted.cost > near.fitted.cost


def effects_of(question: Question, names: frozenset[str]) -> tuple[str, ...]:
    """The effects that a hypothesis adds: those it names, and those that another published form brings."""
    brought = {name for one in question.scene.alternatives if one.name in names for name in one.brings}
    wanted = (names | brought) - set(question.scene.assumed)
    return tuple(effect.name for effect in question.scene.effects if effect.name in wanted)


def details_of(question: Question, names: frozenset[str]) -> tuple[str, ...]:
    """What the laws of these effects leave open."""
    return tuple(one.name for one in question.scene.effects if one.kind == "detail" and names & set(one.partners))


def _starting_from(
    state: Search, names: frozenset[str], effects: tuple[str, ...], near: Hypothesis
) -> Iterator[Fitted]:
    """The fit from the strengths that signatures promise; per form where forms may differ from the assumed ones."""
    question = state.question
    fresh = question.mask(effects) & ~near.fitted.free
    linear, natural = near.fitted.shared.copy(), near.fitted.shared.copy()
    natural[fresh] = question.natural[fresh]
    if fresh.any():
        linear[fresh] += signatures_of(state, near).step(fresh)
    best = min(one.fitted.cost for one in state.tried.values())
    for forms in _forms(question, names):
        alike = forms == near.fitted.forms
        guess = linear if alike else natural
        guess = guess if allowed(question, near.fitted, forms, guess) else near.fitted.shared
        starts = _along(state, near, forms, guess)
        found = fit(question, near.fitted.pieces, effects, forms, guess, starts, GLANCE)
        if near.names <= names and alike and found.cost > near.fitted.cost:  # a long step led some windows astray
            found = fit(question, found.pieces, effects, forms, near.fitted.shared, near.fitted.starts, GLANCE)
        yield found
        hidden = _imitated(question, found, fresh) if alike else found.lack > LEFT
        if hidden and allowed(question, near.fitted, forms, natural):
            anew = fit(question, near.fitted.pieces, effects, forms, natural, None, GLANCE)
            found = min(found, anew, key=lambda one: one.cost)
        explained = near.fitted.cost - best
        if explained > CLEAR and near.fitted.cost - found.cost < _HOPELESS * explained:
            continue
        if found.cost > _REFUTED * near.fitted.cost:
            continue
        found = fit(question, found.pieces, effects, forms, found.shared, found.starts)
        yield found
        if found.lack > LEFT:
            yield from _finer(question, found, names)
        if found.cost > near.fitted.cost:
            yield sought_anew(question, found)


def _along(state: Search, near: Hypothesis, forms: tuple[str, ...], guess: FloatArray) -> tuple[FloatArray, ...]:
    """Starts for other numbers (P,): those of a fit, moved with its parameters where that comes nearer. A spin that an
    effect eats up before it matters would never be found again."""
    fitted = near.fitted
    moved = told_by(state, near).answered(fitted.starts, guess - fitted.shared)
    return nearest(state.question, fitted, forms, guess, [fitted.starts, moved])


def _finer(question: Question, found: Fitted, names: frozenset[str]) -> Iterator[Fitted]:
    """The fit with each detail that its effects leave open, where that gains beyond chance: the law is then another
    form of theirs."""
    for detail in details_of(question, names):
        if detail not in found.names:
            effects = (*found.names, detail)
            finer = fit(question, found.pieces, effects, found.forms, found.shared, found.starts)
            if found.cost - finer.cost > _BEYOND_CHANCE * finer.lack:
                yield finer


def with_details(state: Search, one: Hypothesis) -> Hypothesis:
    """A hypothesis with what its laws leave open, where something is left that this explains."""
    if one.fitted.lack <= LEFT:
        return one
    finer = _finer(state.question, one.fitted, one.names)
    return state.improve(one, min((one.fitted, *finer), key=lambda fitted: fitted.cost))


def on_its_way(state: Search, one: Hypothesis) -> Hypothesis:
    """A hypothesis whose windows follow no wrong path where another one explains them."""
    return one if one.fitted.lack <= LEFT else state.improve(one, straightened(state.question, one.fitted))


def _imitated(question: Question, found: Fitted, fresh: NDArray[np.bool_]) -> bool:
    """Whether hidden states may have taken the place of an effect: much is left, and of the effect's strength, which
    the books know, little was found."""
    known = fresh & (question.natural != question.neutral)
    strength = np.abs(found.shared - question.neutral)[known] / np.abs(question.natural - question.neutral)[known]
    return bool(len(strength) and strength.max() < _LITTLE and found.lack > LEFT)


def _forms(question: Question, names: frozenset[str]) -> list[tuple[str, ...]]:
    """The published forms to try: the assumed ones, but all others where the choice itself is under suspicion."""
    found: list[tuple[str, ...]] = [()]
    for choice in question.scene.alternatives:
        others = [form for form in choice.forms if form != choice.assumed] if choice.name in names else [choice.assumed]
        found = [(*forms, form) for forms in found for form in others]
    return found


def begun_from(question: Question, fitted: Fitted, other: Fitted, forms: tuple[str, ...]) -> Fitted:
    """A fit begun also from the states of another hypothesis, with its own numbers and with those of that; with those
    details that the other one has, and in these `forms`."""
    more = tuple(
        name
        for name in details_of(question, frozenset(fitted.names))
        if name in other.names and name not in fitted.names
    )
    names, begun = (*fitted.names, *more), fitted
    if not more and forms == fitted.forms and fitted.cost <= _REFUTED * other.cost:
        begun = begun_like(question, fitted, other.starts)
    shared = np.where(question.mask((*question.scene.assumed, *names)), other.shared, question.neutral)
    if not allowed(question, other, forms, shared):
        return begun
    found = fit(question, other.pieces, names, forms, shared, other.starts, GLANCE)
    if found.cost >= begun.cost:
        return begun
    return fit(question, found.pieces, names, forms, found.shared, found.starts)
