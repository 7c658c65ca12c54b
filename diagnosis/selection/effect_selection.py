"""Effect selection: signatures propose, joint refits decide, and the evidence is penalised for the number of trials.

Effects are added while the data require one, removed where they are not needed, and replaced by rivals. A choice
between published contact models counts as an effect without a parameter. Every fitted hypothesis keeps its evidence
(Laplace's approximation, divided by the lack of fit), from which probabilities follow.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import COARSE_FIT, FULL_FIT, DiagnosisProblem, EffectFit, fit_effects
from diagnosis.fitting.shot_preparation import MIN_SHOTS_FOR_SELECTION
from diagnosis.fitting.window_continuation import restart_poor_shots
from diagnosis.selection.hypotheses import (
    EffectSearch,
    Hypothesis,
    ProgressCallback,
    Signatures,
    compute_hypothesis_signatures,
    get_shot_information,
    ignore_progress,
)
from diagnosis.selection.hypothesis_trials import (
    POOR_LACK_OF_FIT,
    add_details,
    find_details,
    refit_from,
    restart_poor_windows,
    try_hypothesis,
)
from diagnosis.selection.unknown_effects import SUSPICIOUS_P_VALUE, agreement_p_value
from models.numerics.least_squares import invert_semidefinite
from models.numerics.statistics import correct_for_choices

# Probability of adding any effect where none is missing.
SIGNIFICANCE = 0.01
# Number of hypotheses that are refitted in every step.
REFITS_PER_STEP = 4
# Largest number of missing effects.
MAX_EFFECTS = 3
# Ratio to the predicted gain of the best single effect from which a pair is tried; 20 more are beyond chance.
_PAIR_GAIN_RATIO = 1.5
# Log evidence from which a hypothesis stays refuted on longer windows, which are more informative.
_REFUTED_LOG_EVIDENCE = 40.0
# p-value of a strength above which it is consistent with 0.
_STRENGTH_SIGNIFICANCE = 0.05
# Share of the misfit of the simulator that an effect must explain where more than it explains remains unexplained.
#
# A smaller effect changes the answer by less than the rest does, which may imitate it.
_MIN_SHARE_BESIDE_REST = 0.05
# Predicted chi2 gain from which a further effect is refitted: half of the gain that it would need to be selected.
_MIN_PREDICTED_GAIN = 6.0


def search_effects(
    problem: DiagnosisProblem,
    base: EffectFit,
    longer: Callable[[EffectFit], EffectFit],
    on_progress: ProgressCallback = ignore_progress,
) -> EffectSearch:
    """Search for missing effects, one more at a time, until the data require no more.

    Once no more are required, `longer` extends the windows of the best hypothesis, and the search continues on them.
    All effects that short windows reveal are found first: a missing effect distorts a long window so far that hidden
    states imitate it, and they still do when the effect is added later.

    Args:
        problem: Scene and priors.
        base: Fit of the simulator.
        longer: Function that refits a hypothesis on windows that are as long as it allows.
        on_progress: Receives a description of each step, the names of its effects, and the outlook of the search.

    Returns:
        The search with all hypotheses on the last windows.
    """
    search = EffectSearch(problem, Hypothesis(frozenset(), base), simulator_fit=base, on_progress=on_progress)
    now, extended = search.base, None
    while True:
        now = add_details(search, restart_poor_windows(search, now))
        larger = _find_larger(search, now) if now.size < MAX_EFFECTS else None
        rival = _select_of_size(search, now.size, search.log_evidence(now))
        if larger is not None:
            now = _try_rivals(search, larger)
        elif search.hypotheses[now.names] is not now:
            now = search.hypotheses[now.names]  # a larger one gave it better starts
        elif rival is not None:
            now = rival  # better starts have raised its evidence
        elif extended != now.names:
            search.report_step("extending windows", now.names)
            extended, further = now.names, longer(now.fitted)
            if len(further.segments) < len(now.fitted.segments):
                search = _continue_on_longer_windows(search, Hypothesis(now.names, further))
                now = search.hypotheses[now.names]
                best = search.select_best()
                is_smaller = best.size < now.size and not best.names < now.names and needs_all_effects(search, best)
                now = best if is_smaller else _select_of_size(search, now.size) or now
        else:
            break
    return search


def _continue_on_longer_windows(search: EffectSearch, best: Hypothesis) -> EffectSearch:
    """Continue the search on the longer windows of the best hypothesis.

    Hypotheses near it are refitted there, each from its own strengths. The windows of `simulator_fit` are final once it
    was the best hypothesis.
    """
    problem, fitted = search.problem, best.fitted

    def longer(one: Hypothesis) -> Hypothesis:
        search.report_step("trying on longer windows", one.names)
        own = one.fitted
        refuted = search.log_evidence(search.select_best()) - search.log_evidence(one) > _REFUTED_LOG_EVIDENCE
        options = COARSE_FIT if refuted else FULL_FIT
        refitted = fit_effects(problem, fitted.segments, own.names, own.forms, own.shared, fitted.starts, options)
        return Hypothesis(one.names, refitted if refuted else restart_poor_shots(problem, refitted))

    substitutes = find_substitutes(search, search.hypotheses[best.names])
    first, simulator_fit = (longer(search.base), search.simulator_fit) if best.names else (best, fitted)
    continued = EffectSearch(
        problem,
        first,
        simulator_fit,
        blocked_pairs=search.blocked_pairs,
        on_progress=search.on_progress,
        steps_done=search.steps_done,
    )
    continued.hypotheses[best.names] = best
    for name in best.names:
        continued.record_shared_starts(best, best.names - {name})
    evidence = {names: search.log_evidence(one) for names, one in search.hypotheses.items()}
    ranked = sorted(evidence, key=evidence.__getitem__, reverse=True)
    near = [
        search.hypotheses[names]
        for k, names in enumerate(ranked)
        if (k <= REFITS_PER_STEP or names in substitutes)
        and max(evidence.values()) - evidence[names] < _REFUTED_LOG_EVIDENCE
    ]
    more = [one.names for one in near if one.names > best.names]
    for one in (*near, *(one for one in search.hypotheses.values() if one.names < best.names)):
        if one.names not in (*continued.hypotheses, *more):
            continued.hypotheses[one.names] = longer(one)
    # larger hypotheses are tried again, even where signatures no longer propose what short windows favoured
    for names in more:
        if evidence[names] > evidence[best.names]:
            try_hypothesis(continued, names, continued.hypotheses[best.names])
    return continued


def find_substitutes(search: EffectSearch, best: Hypothesis) -> set[frozenset[str]]:
    """Find, for each effect of the best hypothesis, the most probable hypothesis with another effect in its place.

    Many hypotheses share an effect; they would displace substitutes from the list of the most probable ones.
    """
    substitutes = set()
    for name in sorted(best.names):
        others = [one for one in search.hypotheses.values() if name not in one.names and not one.names < best.names]
        if others:
            substitutes.add(_refit_from_starts(search, max(others, key=search.log_evidence), best).names)
    return substitutes


def _find_larger(search: EffectSearch, now: Hypothesis) -> Hypothesis | None:
    """Find the best hypothesis with one more effect, if it is needed; else the best pair.

    Where two effects of similar size are missing, neither alone explains more than it leaves, so that only a pair is
    accepted.
    """
    proposals = propose_hypotheses(search, now)
    search.plan_steps(len(proposals))
    for names in proposals:
        try_hypothesis(search, names, now)
    larger = _select_larger(search, now)
    partial = None if larger is not None else _find_partial_hypothesis(search, now)
    if partial is None:
        return larger
    for name in _rank_effects(_predict_gains(search, partial)):
        try_hypothesis(search, partial.names | {name}, partial)
    larger = _select_larger(search, now)
    better = search.hypotheses[partial.names] is not partial  # pairs gave it better starts
    return _find_larger(search, now) if larger is None and better else larger


def _select_larger(search: EffectSearch, now: Hypothesis) -> Hypothesis | None:
    """Select the best fitted hypothesis with one more effect, else with two more, if it is more probable and needed."""
    for size in (now.size + 1, now.size + 2):
        more = [one for one in search.hypotheses.values() if one.size == size]
        better = max(more, key=search.log_evidence, default=now)
        if (
            more
            and search.log_evidence_of_size(size) > search.log_evidence_of_size(now.size)
            and needs_all_effects(search, better)
        ):
            return better
    return None


def _find_partial_hypothesis(search: EffectSearch, now: Hypothesis) -> Hypothesis | None:
    """Find the best hypothesis with one more effect that is significant but leaves too much cost to be accepted alone.

    None where two more effects would be too many.
    """
    more = [one for one in search.hypotheses.values() if one.size == now.size + 1]
    best = max(more, key=search.log_evidence, default=now)
    clear = best.size > now.size and all(
        effect_p_value(search, best, name) < SIGNIFICANCE for name in _order_from_weakest(search, best)
    )
    return best if clear and best.fitted.lower_excess_cost > 0 and best.size < MAX_EFFECTS else None


def select_hypothesis(search: EffectSearch) -> Hypothesis:
    """Select the hypothesis of greatest evidence in which every effect is needed.

    It has the most probable number of effects, or fewer where there is no such hypothesis.
    """
    chosen = (_select_of_size(search, size) for size in range(search.most_probable_size(), 0, -1))
    return next((one for one in chosen if one is not None), search.base)


def _select_of_size(search: EffectSearch, size: int, least: float = -np.inf) -> Hypothesis | None:
    """Select, of a number of effects, the hypothesis of greatest evidence in which every one is needed.

    Its log evidence is above `least` and not below that of a smaller hypothesis: whether a less probable one needs all
    effects decides nothing, and takes a fit without each of them.
    """
    evidence = {one.names: search.log_evidence(one) for one in search.hypotheses.values()}
    smaller = max((value for names, value in evidence.items() if len(names) < size), default=-np.inf)
    alike = [names for names, value in evidence.items() if len(names) == size and value > least and value >= smaller]
    ranked = [search.hypotheses[names] for names in sorted(alike, key=evidence.__getitem__, reverse=True)]
    return next((one for one in ranked if needs_all_effects(search, one)), None)


def needs_all_effects(search: EffectSearch, hypothesis: Hypothesis) -> bool:
    """Return whether every effect of a hypothesis has a strength, is significant, and explains more than remains.

    The last condition: a small effect beside a large misfit only substitutes for another one.
    """
    return all(_has_strength(search.problem, hypothesis.fitted, name) for name in hypothesis.names) and all(
        effect_p_value(search, hypothesis, name) < SIGNIFICANCE and _exceeds_rest(search, hypothesis, name)
        for name in _order_from_weakest(search, hypothesis)
    )


def _order_from_weakest(search: EffectSearch, hypothesis: Hypothesis) -> list[str]:
    """Order the effects of a hypothesis by the fit without each, those that are not yet fitted last.

    One effect that is not needed decides, and the weakest is the likeliest.
    """
    without = {name: search.hypotheses.get(hypothesis.names - {name}) for name in sorted(hypothesis.names)}
    return sorted(without, key=lambda name: np.inf if (one := without[name]) is None else one.fitted.cost)


def _has_strength(problem: DiagnosisProblem, fitted: EffectFit, name: str) -> bool:
    """Return whether the strength of an effect, with the details of its law, differs from 0; a form has no strength.

    Without it, a gain in fit comes from a window on another path.
    """
    if not problem.mask((name,)).any():
        return True
    own = problem.mask((name, *find_details(problem, frozenset({name})))) & fitted.free
    here = own[fitted.free]
    strength = (fitted.shared - problem.neutral(fitted.forms))[own]
    square = float(strength @ invert_semidefinite(fitted.shooting.covariance[np.ix_(here, here)]) @ strength)
    return bool(square > chi2.isf(_STRENGTH_SIGNIFICANCE, len(strength)))


def _exceeds_rest(search: EffectSearch, hypothesis: Hypothesis, name: str) -> bool:
    """Return whether an effect of a hypothesis explains more cost than the hypothesis leaves beyond noise.

    The size of the noise may be off a little; where shots disagree about several effects and are few, any cost may be
    systematic. Real motion keeps a rest that no law explains, and which refutes no effect: where generic laws explain
    less of it, that is what an effect must exceed, and a share of the misfit of the simulator. Where one effect was
    blocked, effects trade strength; each must then explain that share of what remains without it.
    """
    without = fit_without_effect(search, hypothesis, name)
    gain = without.cost - hypothesis.fitted.cost
    few = len({segment.shot for segment in hypothesis.fitted.segments}) < MIN_SHOTS_FOR_SELECTION
    disputed = few and hypothesis.size > 1 and not _do_shots_agree(search, hypothesis)
    beyond_noise = hypothesis.fitted.upper_excess_cost if disputed else hypothesis.fitted.lower_excess_cost
    if gain >= beyond_noise or not search.problem.probes:
        return gain >= beyond_noise
    trades_strength = any(pair <= hypothesis.names for pair in search.blocked_pairs)
    whole = without if trades_strength else search.base.fitted
    least = _MIN_SHARE_BESIDE_REST * whole.lower_excess_cost
    return gain >= least and gain >= search.generic_law_gain(hypothesis)


def _do_shots_agree(search: EffectSearch, hypothesis: Hypothesis) -> bool:
    """Return whether all shots may have the same strengths."""
    return agreement_p_value((get_shot_information(search, hypothesis), hypothesis.fitted)) > SUSPICIOUS_P_VALUE


def fit_without_effect(search: EffectSearch, hypothesis: Hypothesis, name: str) -> EffectFit:
    """Fit a hypothesis without one of its effects, at least as well as from the starts of the larger one.

    A gain from another order of contacts must not count as evidence for an effect.

    Args:
        search: The search; it keeps the fit.
        hypothesis: The larger hypothesis.
        name: The effect to remove.

    Returns:
        The fit without the effect.
    """
    return _refit_from_starts(search, try_hypothesis(search, hypothesis.names - {name}, hypothesis), hypothesis).fitted


def _refit_from_starts(search: EffectSearch, other: Hypothesis, one: Hypothesis) -> Hypothesis:
    """Refit `other` from the starts of the hypothesis that it is compared with, and keep the better fit."""
    if other.fitted.segments is not one.fitted.segments or search.has_shared_starts(one, other):
        return other
    search.record_shared_starts(one, other.names)
    choices = zip(search.problem.scene.alternatives, one.fitted.forms, other.fitted.forms, strict=True)
    forms = tuple(own if choice.name in other.names & one.names else current for choice, own, current in choices)
    return search.replace_fit(other, refit_from(search.problem, other.fitted, one.fitted, forms))


def effect_p_value(search: EffectSearch, hypothesis: Hypothesis, name: str) -> float:
    """Return the probability that the best of all choices gains as much by chance."""
    without = fit_without_effect(search, hypothesis, name)
    gain = (without.cost - hypothesis.fitted.cost) / max(hypothesis.fitted.lack_of_fit, 1.0)
    more = max(int(hypothesis.fitted.free.sum() - without.free.sum()), 1)
    return correct_for_choices(float(chi2.sf(max(gain, 0.0), more)), len(search.choices))


def propose_hypotheses(search: EffectSearch, now: Hypothesis) -> list[frozenset[str]]:
    """Propose larger hypotheses by predicted gain, with other contact models and, from no effects, also a pair."""
    problem, signatures = search.problem, compute_hypothesis_signatures(search, now)
    gains = _predict_gains(search, now)
    # near a fit that leaves only noise, predictions hold
    is_poor = now.fitted.lack_of_fit > POOR_LACK_OF_FIT
    first = [name for name in _rank_effects(gains) if gains[name] > _MIN_PREDICTED_GAIN or (is_poor and not now.names)]
    if is_poor:
        # effects that act here and have a usual strength in the literature
        is_natural = problem.natural != problem.neutral(problem.simulator_forms)
        masks = {name: problem.mask((name,)) for name in gains if name not in first}
        first += [name for name, mask in masks.items() if signatures.raw[mask].any() and is_natural[mask].any()]
        blocked = _find_blocked_partners(search, now, signatures)
        search.blocked_pairs.update(blocked)
        first += sorted({name for pair in blocked for name in pair - now.names} - {*first})
    forms = [choice.name for choice in problem.scene.alternatives if choice.name not in now.names]
    if now.names and now.fitted.lower_excess_cost == 0 and _do_shots_agree(search, now):
        forms = []  # effects that leave only noise replace a form
    proposals = [now.names | {name} for name in (*first, *forms)]
    if not now.names and len(gains) > 1:
        pairs = {two: _predict_gain(search, signatures, two) for two in combinations(gains, 2)}
        best = max(pairs, key=pairs.__getitem__)
        # neither effect would be found alone
        proposals += [frozenset(best)] if pairs[best] > _PAIR_GAIN_RATIO * max(gains.values()) + 20.0 else []
    return proposals


def _find_blocked_partners(search: EffectSearch, now: Hypothesis, signatures: Signatures) -> list[frozenset[str]]:
    """Find effects of a hypothesis, each with a partner that its bounds keep absent beside the fitted strengths.

    To first order the data ask for less of them than nothing; beside other strengths of their partner, they may ask for
    more: a strong actuator seems to turn less than the inertia of its file, until its rotor is known.
    """
    problem, blocked = search.problem, []
    for effect in (one for one in problem.scene.effects if one.name in now.names):
        for name in sorted({*effect.partners} & {*problem.candidates} - now.names):
            mask, step = problem.mask((name,)), np.zeros(len(problem.priors))
            step[mask] = signatures.step(mask)
            absent = now.fitted.shared[mask]
            if signatures.raw[mask].any() and (problem.clip_to_bounds(now.fitted.shared + step)[mask] == absent).all():
                blocked.append(frozenset({effect.name, name}))
    return blocked


def _predict_gains(search: EffectSearch, now: Hypothesis) -> dict[str, float]:
    """Predict the chi2 gain of every further effect."""
    effect_signatures = compute_hypothesis_signatures(search, now)
    return {
        name: _predict_gain(search, effect_signatures, (name,))
        for name in search.problem.candidates
        if name not in now.names
    }


def _rank_effects(gains: dict[str, float]) -> list[str]:
    """Return the effects with the largest predicted gains."""
    return sorted(gains, key=lambda name: gains[name], reverse=True)[:REFITS_PER_STEP]


def _predict_gain(search: EffectSearch, effect_signatures: Signatures, names: tuple[str, ...]) -> float:
    """Predict the chi2 gain of effects to first order, less the chance gain of their number of parameters."""
    mask = search.problem.mask(names)
    return effect_signatures.gain(mask) - 2.0 * int(mask.sum())


def _try_rivals(search: EffectSearch, now: Hypothesis) -> Hypothesis:
    """Replace each effect of a hypothesis by its nearest rivals, and return the best hypothesis.

    Rivals are fitted on windows that the smaller hypotheses allow. On windows that only the right hypothesis allows, a
    wrong one follows wrong paths at great cost, and its misfit holds no information.
    """
    for name in sorted(now.names) if now.size > 1 else ():
        rest = try_hypothesis(search, now.names - {name}, now)
        effect_signatures = compute_hypothesis_signatures(search, rest)
        rivals = [other for other in search.problem.candidates if other not in now.names]
        rivals.sort(key=lambda other: _predict_gain(search, effect_signatures, (other,)), reverse=True)
        for other in rivals[:2]:
            try_hypothesis(search, rest.names | {other}, rest)
    return _select_of_size(search, now.size) or now
