"""Which effects are missing: signatures propose, joint refits decide, evidence is penalised for what was tried.

Effects are added while the data ask for one, taken away again where they turn out not to be needed, and exchanged for
others; a choice between published forms counts as an effect without a parameter. Every hypothesis ever fitted keeps
its evidence (Laplace's approximation, divided by the lack of fit), from which probabilities follow.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import GLANCE, USUAL, Fitted, Question, fit
from diagnosis.fitting.shot_split import FEW
from diagnosis.fitting.window_growth import sought_anew
from diagnosis.selection.hypotheses import Hypothesis, Search, Watch, signatures_of, told_by, unwatched
from diagnosis.selection.hypothesis_trials import LEFT, begun_from, details_of, on_its_way, tried, with_details
from diagnosis.selection.signatures import Signatures
from diagnosis.selection.unknown_effects import SUSPICIOUS, agreement

SIGNIFICANT = 0.01
"""chance to add any effect where none is missing."""
TRIED = 4
"""hypotheses that are refitted at every step."""
MOST = 3
"""effects missing at once."""
_ONLY_TOGETHER = 1.5
"""times what the best single effect promises, from which two are tried at once; 20 more are beyond chance."""
_REFUTED = 40.0
"""log evidence from which a hypothesis stays refuted on longer windows, which tell more."""
_NO_STRENGTH = 0.05
"""chance that what is not there has as large a strength, above which an effect has none."""
_WORTH = 6.0
"""chi2 that an effect beside others must promise to be refitted: half of what it would need to be adopted."""


def search(question: Question, base: Fitted, longer: Callable[[Fitted], Fitted], watch: Watch = unwatched) -> Search:
    """Try larger hypotheses, one effect more at a time, until nothing more is asked for; `longer` then gives the best
    one windows as long as it allows, on which the search goes on.

    All that short windows ask for is found before they grow: what is missing bends a long one so far that hidden states
    imitate it, and keep doing so when the fit is given what it lacked.
    """
    state = Search(question, Hypothesis(frozenset(), base), alone=base, watch=watch)
    now, lengthened = state.base, None
    while True:
        now = with_details(state, on_its_way(state, now))
        larger = _larger(state, now) if now.size < MOST else None
        rival = _best_needed(state, now.size)
        if larger is not None:
            now = _exchanged(state, larger)
        elif state.tried[now.names] is not now:
            now = state.tried[now.names]  # a larger one has shown it better starts
        elif rival is not None and state.weigh(rival) > state.weigh(now):
            now = rival  # the same has made it likelier
        elif lengthened != now.names:
            watch("following for longer", tuple(sorted(now.names)))
            lengthened, further = now.names, longer(now.fitted)
            if len(further.pieces) < len(now.fitted.pieces):
                state = _taken_up(state, Hypothesis(now.names, further))
                now = _of_no_more(state, state.tried[now.names])
        else:
            break
    return state


def _taken_up(former: Search, best: Hypothesis) -> Search:
    """The search on the longer windows that the best hypothesis allows: with those that were near it, each from its own
    strengths; the simulator alone has grown as far as it can once it was the best."""
    question, fitted = former.question, best.fitted

    def longer(one: Hypothesis) -> Hypothesis:
        former.watch("trying for longer", tuple(sorted(one.names)))
        own, refuted = one.fitted, former.weigh(former.best()) - former.weigh(one) > _REFUTED
        options = GLANCE if refuted else USUAL
        found = fit(question, fitted.pieces, own.names, own.forms, own.shared, fitted.starts, options)
        return Hypothesis(one.names, found if refuted else sought_anew(question, found))

    instead = stand_ins(former, former.tried[best.names])
    first, alone = (longer(former.base), former.alone) if best.names else (best, fitted)
    state = Search(question, first, alone, watch=former.watch)
    state.tried[best.names] = best
    for name in best.names:
        state.lend(best, best.names - {name})
    ranked = sorted(former.tried.values(), key=former.weigh, reverse=True)
    rivals = [*ranked[: TRIED + 1], *(one for one in ranked[TRIED + 1 :] if one.names in instead)]
    near = [one for one in rivals if former.weigh(former.best()) - former.weigh(one) < _REFUTED]
    more = [one.names for one in near if one.names > best.names]
    for one in (*near, *(one for one in former.tried.values() if one.names < best.names)):
        if one.names not in (*state.tried, *more):
            state.tried[one.names] = longer(one)
    # what more is missing is asked anew, also where slopes no longer show what short windows made likelier
    for names in more:
        if former.weigh(former.tried[names]) > former.weigh(former.tried[best.names]):
            tried(state, names, state.tried[best.names])
    return state


def stand_ins(state: Search, best: Hypothesis) -> set[frozenset[str]]:
    """Per effect of the best hypothesis, the likeliest one that has another in its place: sets that share an effect are
    many, and would crowd it out of those that are near."""
    found = set()
    for name in sorted(best.names):
        others = [one for one in state.tried.values() if name not in one.names and not one.names < best.names]
        if others:
            found.add(_levelled(state, max(others, key=state.weigh), best).names)
    return found


def _of_no_more(state: Search, now: Hypothesis) -> Hypothesis:
    """The likeliest hypothesis of as many effects in which every one is needed, or one of fewer that stand in for them
    and are likelier than all others; the same where there is none."""
    best = state.best()
    if best.size < now.size and not best.names < now.names and needed(state, best):
        return best
    return _best_needed(state, now.size) or now


def _larger(state: Search, now: Hypothesis) -> Hypothesis | None:
    """The best hypothesis of one effect more, where that one is needed; else the best pair: of two effects that do as
    much, neither alone explains more than it leaves."""
    for names in proposals(state, now):
        tried(state, names, now)
    found = _needed_beside(state, now)
    half = None if found is not None else _half(state, now)
    if half is None:
        return found
    for name in _first(_gains(state, half)):
        tried(state, half.names | {name}, half)
    found = _needed_beside(state, now)
    better = state.tried[half.names] is not half  # those of two have shown it better starts
    return _larger(state, now) if found is None and better else found


def _needed_beside(state: Search, now: Hypothesis) -> Hypothesis | None:
    """The best hypothesis tried of one effect more, else of two more, that is likelier and needed."""
    for size in (now.size + 1, now.size + 2):
        more = [one for one in state.tried.values() if one.size == size]
        better = max(more, key=state.weigh, default=now)
        if more and state.total(size) > state.total(now.size) and needed(state, better):
            return better
    return None


def _half(state: Search, now: Hypothesis) -> Hypothesis | None:
    """The best hypothesis of one effect more where chance does not explain it and it leaves too much to be needed; none
    where two more would be too many."""
    more = [one for one in state.tried.values() if one.size == now.size + 1]
    best = max(more, key=state.weigh, default=now)
    clear = best.size > now.size and all(chance(state, best, name) < SIGNIFICANT for name in best.names)
    return best if clear and best.fitted.excess > 0 and best.size < MOST else None


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
    """Whether every effect has a strength, and leaving it out costs more than chance among as many choices explains,
    and not less than what stays unexplained: a small effect beside a large misfit only stands in for it."""
    return all(_has_strength(state.question, one.fitted, name) for name in one.names) and all(
        chance(state, one, name) < SIGNIFICANT and lacking(state, one, name).cost - one.fitted.cost >= _left(state, one)
        for name in one.names
    )


def _has_strength(question: Question, fitted: Fitted, name: str) -> bool:
    """Whether an effect, with what its law leaves open, is told from none of it; another form has no strength to tell.
    What a fit gains by an effect of no strength is a window on another path."""
    if not question.mask((name,)).any():
        return True
    own = question.mask((name, *details_of(question, frozenset({name})))) & fitted.free
    here = own[fitted.free]
    strength = (fitted.shared - question.neutral)[own]
    square = float(strength @ np.linalg.pinv(fitted.shooting.covariance[np.ix_(here, here)]) @ strength)
    return bool(square > chi2.isf(_NO_STRENGTH, len(strength)))


def _left(state: Search, one: Hypothesis) -> float:
    """Cost that a hypothesis leaves unexplained: what no misjudged size of the noise explains. Where shots disagree
    about several effects, and are too few to contradict each other: all that may be more than noise."""
    few = len({piece.shot for piece in one.fitted.pieces}) < FEW
    disputed = few and one.size > 1 and not _agreed(state, one)
    return one.fitted.doubtful if disputed else one.fitted.excess


def _agreed(state: Search, one: Hypothesis) -> bool:
    """Whether all shots may have the same strengths."""
    return agreement(told_by(state, one), one.fitted) > SUSPICIOUS


def lacking(state: Search, one: Hypothesis, name: str) -> Fitted:
    """The fit of a hypothesis that lacks one of its effects, at least as good as from the starts of the larger one:
    what a window gains by another order of its contacts must not speak for an effect."""
    return _levelled(state, tried(state, one.names - {name}, one), one).fitted


def _levelled(state: Search, other: Hypothesis, one: Hypothesis) -> Hypothesis:
    """A hypothesis at least as good as from the starts of the `one` that it is weighed against."""
    if other.fitted.pieces is not one.fitted.pieces or state.has_lent(one, other):
        return other
    state.lend(one, other.names)
    choices = zip(state.question.scene.alternatives, one.fitted.forms, other.fitted.forms, strict=True)
    forms = tuple(own if choice.name in other.names else kept for choice, own, kept in choices)
    return state.improve(other, begun_from(state.question, other.fitted, one.fitted, forms))


def chance(state: Search, one: Hypothesis, name: str) -> float:
    """Probability that adding the best of all choices to the others gains as much without cause (Sidak 1967)."""
    without = lacking(state, one, name)
    gain = (without.cost - one.fitted.cost) / max(one.fitted.lack, 1.0)
    more = max(int(one.fitted.free.sum() - without.free.sum()), 1)
    single = float(chi2.sf(max(gain, 0.0), more))
    return -float(np.expm1(len(state.choices) * np.log1p(-min(single, 1 - 1e-16))))


def proposals(state: Search, now: Hypothesis) -> list[frozenset[str]]:
    """The next larger hypotheses that signatures rank first, other published forms, and from nothing also a pair."""
    found = signatures_of(state, now)
    gains = _gains(state, now)
    first = [name for name in _first(gains) if gains[name] > _WORTH or not now.names]
    if now.fitted.lack > LEFT:
        first += [name for name in gains if name not in first and _strength_known(state.question, name)]
    forms = [choice.name for choice in state.question.scene.alternatives if choice.name not in now.names]
    forms = [] if now.names and _settled(state, now) else forms  # effects that leave noise alone stand for the form
    proposals = [now.names | {name} for name in (*first, *forms)]
    if not now.names:
        pairs = sorted(combinations(gains, 2), key=lambda two: _promise(state, found, two), reverse=True)
        proposals += [frozenset(two) for two in pairs[:1] if _beats(state, found, two, gains)]
    return proposals


def _settled(state: Search, now: Hypothesis) -> bool:
    """Whether a hypothesis leaves noise alone, and all shots agree about its strengths."""
    return now.fitted.excess == 0 and _agreed(state, now)


def _gains(state: Search, now: Hypothesis) -> dict[str, float]:
    """chi2 that every effect promises to gain beside a hypothesis."""
    found = signatures_of(state, now)
    return {name: _promise(state, found, (name,)) for name in state.question.candidates if name not in now.names}


def _first(gains: dict[str, float]) -> list[str]:
    """The effects that promise most."""
    return sorted(gains, key=lambda name: gains[name], reverse=True)[:TRIED]


def _strength_known(question: Question, name: str) -> bool:
    mask = question.mask((name,))
    return bool((question.natural != question.neutral)[mask].any())


def _beats(state: Search, found: Signatures, two: tuple[str, ...], gains: dict[str, float]) -> bool:
    """Whether a pair promises so much more than the best single effect that neither would be found alone."""
    return _promise(state, found, two) > _ONLY_TOGETHER * max(gains.values()) + 20.0


def _promise(state: Search, found: Signatures, names: tuple[str, ...]) -> float:
    """chi2 that effects gain to first order, less what so many parameters gain by chance."""
    mask = state.question.mask(names)
    return found.gain(mask) - 2.0 * int(mask.sum())


def _exchanged(state: Search, now: Hypothesis) -> Hypothesis:
    """The best of a hypothesis and those in which one of its effects gave way to a near rival.

    Rivals are fitted on windows that the smaller hypotheses allow too: on those that only the right one allows, a wrong
    one follows wrong paths, at great cost, and nothing is learnt from how much it leaves.
    """
    for name in now.names if now.size > 1 else ():
        rest = tried(state, now.names - {name}, now)
        found = signatures_of(state, rest)
        rivals = [other for other in state.question.candidates if other not in now.names]
        rivals.sort(key=lambda other: _promise(state, found, (other,)), reverse=True)
        for other in rivals[:2]:
            tried(state, rest.names | {other}, rest)
    return _best_needed(state, now.size) or now
