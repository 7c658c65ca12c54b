"""Fits of a hypothesis: from a near one, from strengths that signatures predict, or from the literature."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from diagnosis.fitting.hypothesis_fits import (
    ALL_GUESSES_FIT,
    COARSE_FIT,
    DiagnosisProblem,
    EffectFit,
    can_simulate,
    fit_effects,
    refit_effects,
    select_best_starts,
)
from diagnosis.fitting.window_continuation import adopt_better_starts, restart_poor_shots, restart_while_improving
from diagnosis.selection.hypotheses import (
    REFUTED_RIVAL_LOG_EVIDENCE,
    EffectSearch,
    Hypothesis,
    compute_hypothesis_signatures,
    get_shot_information,
)
from diagnosis.selection.unknown_effects import SUSPICIOUS_P_VALUE, agreement_p_value
from models.core.typing import BoolArray, FloatArray

# chi2 gain from which a hypothesis explains something.
CLEAR_GAIN = 50.0
# Lack of fit from which residuals are systematic.
POOR_LACK_OF_FIT = 1.2
# chi2 gain that a detail needs: one parameter gains as much by chance once in a hundred thousand cases.
_MIN_DETAIL_GAIN = 20.0
# Share of the gain of the best hypothesis that a coarse fit must reach to be fitted fully.
_MIN_COARSE_SHARE = 0.25
# Share of the gain of the best of several contact models that a coarse fit must reach to be fitted fully: only the best
# one of them counts.
_MIN_FORM_SHARE = 0.75
# Ratio to the cost of the near hypothesis from which better starts alone cannot help.
_HOPELESS_COST_RATIO = 3.0
# Multiples of the usual strength from which an effect is fitted that came to nothing at a bound: the usual one, and the
# middle between it and a large one, ten times as large. One start alone ends in a local minimum (recorded servo).
_BLOCKED_STARTS = (1.0, 10**0.5)
# Share of the natural strength up to which hidden states may have absorbed an effect.
#
# The effect is then fitted from its natural strength, with start states from initial guesses: those of a fit without it
# would keep imitating it. The same holds for another contact model with a large misfit.
_ABSORBED_STRENGTH_SHARE = 0.5


def try_hypothesis(search: EffectSearch, names: frozenset[str], near: Hypothesis) -> Hypothesis:
    """Fit a hypothesis from a near one, unless a good fit exists."""
    existing = search.hypotheses.get(names)
    if existing is not None:
        # worse than with fewer effects, and not started from that fit: it is on a wrong path
        added = existing.names - near.names
        nested = near.names < existing.names and not any(one.name in added for one in search.problem.scene.alternatives)
        alike = existing.fitted.segments is near.fitted.segments and not search.has_shared_starts(near, existing)
        if not (nested and alike and existing.fitted.cost > near.fitted.cost):
            return existing
    search.report_step("trying", names)
    problem = search.problem
    effects = find_added_effects(problem, names)
    effects += tuple(one for one in find_details(problem, names) if one in near.fitted.names and one not in effects)
    best = min(_iterate_fits(search, names, effects, near), key=lambda fitted: fitted.cost)
    if existing is not None:
        search.record_shared_starts(near, names)
        return search.replace_fit(existing, min(existing.fitted, best, key=lambda fitted: fitted.cost))
    search.hypotheses[names] = Hypothesis(names, best)
    return search.hypotheses[names]


def find_added_effects(problem: DiagnosisProblem, names: frozenset[str]) -> tuple[str, ...]:
    """Find the effects that a hypothesis adds: those that it names, and the companions of another contact model."""
    brought = {name for one in problem.scene.alternatives if one.name in names for name in one.companions}
    wanted = (names | brought) - set(problem.scene.simulator_effects)
    return tuple(effect.name for effect in problem.scene.effects if effect.name in wanted)


def find_details(problem: DiagnosisProblem, names: frozenset[str]) -> tuple[str, ...]:
    """Find the details that the laws of these effects leave open."""
    return tuple(one.name for one in problem.scene.effects if one.kind == "detail" and names & set(one.partners))


def _iterate_fits(
    search: EffectSearch, names: frozenset[str], effects: tuple[str, ...], near: Hypothesis
) -> Iterator[EffectFit]:
    """Yield fits from the strengths that signatures predict, for each combination of contact models."""
    problem = search.problem
    fresh = problem.mask(effects) & ~near.fitted.free
    linear, natural = near.fitted.shared.copy(), near.fitted.shared.copy()
    natural[fresh] = problem.natural[fresh]
    if fresh.any():
        linear[fresh] += compute_hypothesis_signatures(search, near).step(fresh)
        linear = problem.clip_to_bounds(linear)
    coarse = [
        _fit_coarsely(search, near, names, effects, forms, linear if forms == near.fitted.forms else natural)
        for forms in _list_forms(problem, names, near)
    ]
    yield from coarse
    yield from _iterate_fits_from_usual_strengths(problem, near, coarse, fresh)
    explained = near.fitted.cost - min(one.fitted.cost for one in search.hypotheses.values())
    most = near.fitted.cost - min(fitted.cost for fitted in coarse)
    for fitted in coarse:
        gain = near.fitted.cost - fitted.cost
        if (explained > CLEAR_GAIN and gain < _MIN_COARSE_SHARE * explained) or (
            most > CLEAR_GAIN and gain < _MIN_FORM_SHARE * most
        ):
            continue
        if fitted.cost > _HOPELESS_COST_RATIO * near.fitted.cost:
            continue
        fitted = fit_effects(problem, fitted.segments, effects, fitted.forms, fitted.shared, fitted.starts)
        yield fitted
        if fitted.lack_of_fit > POOR_LACK_OF_FIT:
            yield from _iterate_detailed_fits(problem, fitted, names)
        if fitted.cost > near.fitted.cost:
            yield restart_poor_shots(problem, fitted)


def _iterate_fits_from_usual_strengths(
    problem: DiagnosisProblem, near: Hypothesis, coarse: list[EffectFit], fresh: BoolArray
) -> Iterator[EffectFit]:
    """Yield fits of added effects that came to nothing at a bound, from strengths on its inner side.

    The other effects have taken such values without it that its strength would have to become negative, and leave a
    large misfit; beside other values of theirs, it may explain more. A few iterations do not reach these.
    """
    low, high, sigma = np.transpose([(*prior.bounds, prior.sigma) for prior in problem.priors])
    for fitted in coarse:
        neutral = problem.neutral(fitted.forms)
        masks = [fresh & problem.mask((name,)) for name in fitted.names]
        absent = np.any([mask & np.all((fitted.shared == neutral)[mask]) for mask in masks], axis=0)
        inward = absent * ((neutral == low).astype(float) - (neutral == high))
        if fitted.forms == near.fitted.forms and fitted.lack_of_fit > POOR_LACK_OF_FIT and inward.any():
            guesses = [problem.clip_to_bounds(fitted.shared + size * inward * sigma) for size in _BLOCKED_STARTS]
            for k, guess in enumerate(guesses):
                is_repeated = k > 0 and np.array_equal(guess, guesses[k - 1])  # both beyond a bound
                if not is_repeated and can_simulate(problem, near.fitted, fitted.forms, guess):
                    yield fit_effects(problem, fitted.segments, fitted.names, fitted.forms, guess, near.fitted.starts)


def _fit_coarsely(
    search: EffectSearch,
    near: Hypothesis,
    names: frozenset[str],
    effects: tuple[str, ...],
    forms: tuple[str, ...],
    guess: FloatArray,
) -> EffectFit:
    """Fit effects with given contact models in a few iterations, from a near hypothesis or from the data alone."""
    problem, segments = search.problem, near.fitted.segments
    fresh, alike = problem.mask(effects) & ~near.fitted.free, forms == near.fitted.forms
    active = problem.mask((*problem.scene.simulator_effects, *effects))
    current, guess = (np.where(active, one, problem.neutral(forms)) for one in (near.fitted.shared, guess))
    guess = guess if can_simulate(problem, near.fitted, forms, guess) else current
    # those of the near fit, shifted with the active parameters where that is closer: a spin that an effect consumes
    # early could not be recovered from unshifted starts
    shift = np.where(active, guess - near.fitted.shared, 0.0)
    moved = get_shot_information(search, near).shift_starts(near.fitted.starts, shift)
    starts = select_best_starts(problem, near.fitted, forms, guess, [near.fitted.starts, moved])
    fitted = fit_effects(problem, segments, effects, forms, guess, starts, COARSE_FIT)
    # a long step can put some windows on wrong paths
    if near.names <= names and alike and fitted.cost > near.fitted.cost:
        fitted = fit_effects(problem, segments, effects, forms, near.fitted.shared, near.fitted.starts, COARSE_FIT)
    natural = np.where(fresh, problem.natural, current)
    hidden = _may_be_absorbed(problem, fitted, fresh) if alike else fitted.lack_of_fit > POOR_LACK_OF_FIT
    if hidden and can_simulate(problem, near.fitted, forms, natural):
        from_guesses = fit_effects(problem, segments, effects, forms, natural, None, COARSE_FIT)
        fitted = min(fitted, from_guesses, key=lambda one: one.cost)
    return fitted


def _iterate_detailed_fits(problem: DiagnosisProblem, fitted: EffectFit, names: frozenset[str]) -> Iterator[EffectFit]:
    """Yield fits with each detail that the effects leave open, where the gain is beyond chance."""
    for detail in find_details(problem, names):
        if detail not in fitted.names:
            effects = (*fitted.names, detail)
            finer = fit_effects(problem, fitted.segments, effects, fitted.forms, fitted.shared, fitted.starts)
            if fitted.cost - finer.cost > _MIN_DETAIL_GAIN * finer.lack_of_fit:
                yield finer


def add_details(search: EffectSearch, one: Hypothesis) -> Hypothesis:
    """Add details to a hypothesis where they explain systematic residuals."""
    if one.fitted.lack_of_fit <= POOR_LACK_OF_FIT:
        return one
    detailed = _iterate_detailed_fits(search.problem, one.fitted, one.names)
    return search.replace_fit(one, min((one.fitted, *detailed), key=lambda fitted: fitted.cost))


def restart_poor_windows(search: EffectSearch, one: Hypothesis) -> Hypothesis:
    """Restart the windows of a hypothesis with systematic residuals."""
    if one.fitted.lack_of_fit <= POOR_LACK_OF_FIT:
        return one
    return search.replace_fit(one, restart_while_improving(search.problem, one.fitted))


def restart_disagreeing_shots(search: EffectSearch) -> None:
    """Refit the best hypotheses from all initial guesses, where they leave only noise but shots disagree.

    A side spin that the cloth removes before a contact has no gradient: a fit without it may pass as noise, and then
    the shot seems to have parameters of its own. Where more than noise is left, a missing effect makes shots disagree.

    Args:
        search: A finished search; better fits replace its own.
    """
    best = search.select_best()
    agreement = agreement_p_value((get_shot_information(search, best), best.fitted))
    if agreement > SUSPICIOUS_P_VALUE or best.fitted.lower_excess_cost > 0:
        return
    least = search.log_evidence(best) - REFUTED_RIVAL_LOG_EVIDENCE
    for one in [one for one in search.hypotheses.values() if search.log_evidence(one) >= least]:
        search.report_step("restarting", one.names)
        own = one.fitted
        refitted = refit_effects(search.problem, own.segments, own, own.starts, True, ALL_GUESSES_FIT)
        search.replace_fit(one, min(own, refitted, key=lambda fitted: fitted.cost))


def _may_be_absorbed(problem: DiagnosisProblem, fitted: EffectFit, fresh: BoolArray) -> bool:
    """Return whether hidden states may have absorbed an effect: the misfit is large, the fitted strength small."""
    neutral = problem.neutral(fitted.forms)
    has_natural = fresh & (problem.natural != neutral)
    strength = np.abs(fitted.shared - neutral)[has_natural] / np.abs(problem.natural - neutral)[has_natural]
    return bool(len(strength) and strength.max() < _ABSORBED_STRENGTH_SHARE and fitted.lack_of_fit > POOR_LACK_OF_FIT)


def _list_forms(problem: DiagnosisProblem, names: frozenset[str], near: Hypothesis) -> list[tuple[str, ...]]:
    """List the combinations of contact models to try: all others where the choice is under test.

    A choice that the near hypothesis has made stays: all of its forms were compared there.
    """
    combinations: list[tuple[str, ...]] = [()]
    for choice, current in zip(problem.scene.alternatives, near.fitted.forms, strict=True):
        others = [choice.simulator_form]
        if choice.name in names & near.names:
            others = [current]
        elif choice.name in names:
            others = [form for form in choice.forms if form != choice.simulator_form]
        combinations = [(*forms, form) for forms in combinations for form in others]
    return combinations


def refit_from(problem: DiagnosisProblem, fitted: EffectFit, other: EffectFit, forms: tuple[str, ...]) -> EffectFit:
    """Refit a hypothesis from the start states of another one, with its own parameters and with those of the other.

    It takes over the details of the other, and has the given `forms`.
    """
    more = tuple(
        name
        for name in find_details(problem, frozenset(fitted.names))
        if name in other.names and name not in fitted.names
    )
    names, restarted = (*fitted.names, *more), fitted
    if not more and forms == fitted.forms and fitted.cost <= _HOPELESS_COST_RATIO * other.cost:
        restarted = adopt_better_starts(problem, fitted, other.starts)
    shared = np.where(problem.mask((*problem.scene.simulator_effects, *names)), other.shared, problem.neutral(forms))
    if not can_simulate(problem, other, forms, shared):
        return restarted
    coarse = fit_effects(problem, other.segments, names, forms, shared, other.starts, COARSE_FIT)
    if coarse.cost >= restarted.cost:
        return restarted
    return fit_effects(problem, coarse.segments, names, forms, coarse.shared, coarse.starts)
