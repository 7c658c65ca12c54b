"""Evidence across shots: effects whose strengths are fitted to some shots must improve the fit of others."""

from __future__ import annotations

from diagnosis.fitting.hypothesis_fits import (
    COARSE_FIT,
    FULL_FIT,
    DiagnosisProblem,
    EffectFit,
    fit_start_states,
    refit_effects,
)
from diagnosis.selection.effect_selection import fit_without_effect, select_hypothesis
from diagnosis.selection.hypotheses import EffectSearch, Hypothesis
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions


def confirm_effects(
    problem: DiagnosisProblem, search: EffectSearch, first: tuple[Recording, ...], second: tuple[Recording, ...]
) -> Hypothesis:
    """Drop effects that `second` shots do not confirm, with strengths from the `first` shots.

    Args:
        problem: Scene and priors.
        search: The finished search.
        first: Fitting shots.
        second: Selection shots; if empty, each shot is tested with strengths from the others.

    Returns:
        The hypothesis of the effects that remain.
    """
    best, split = select_hypothesis(search), split_folds(first, second)
    while split and best.size > 1:
        gains = dict.fromkeys(sorted(best.names), 0.0)
        # a fit without an effect converges slowly; a coarse fit favours no hypothesis, as it starts from all shots
        without = {name: fit_without_effect(search, best, name) for name in gains}
        for others, here in split:
            whole = refit_on_shots(problem, others, best.fitted)
            for name in gains:
                gains[name] += cross_shot_gain(
                    problem, best.fitted, here, refit_on_shots(problem, others, without[name], COARSE_FIT), whole
                )
        least = min(gains, key=lambda name: gains[name])
        if gains[least] > 0:
            break
        best = search.hypotheses[best.names - {least}]
    return best


def split_folds(
    first: tuple[Recording, ...], second: tuple[Recording, ...]
) -> list[tuple[tuple[Recording, ...], tuple[Recording, ...]]]:
    """Split shots into pairs of shots that estimate strengths and shots that test them."""
    if second:
        return [(first, second)]
    numbers = sorted({one.shot for one in first})
    split = (
        (tuple(one for one in first if one.shot != n), tuple(one for one in first if one.shot == n)) for n in numbers
    )
    return [fold for fold in split if fold[0]]


def cross_shot_gain(
    problem: DiagnosisProblem, whole: EffectFit, recordings: tuple[Recording, ...], base: EffectFit, best: EffectFit
) -> float:
    """Return the chi2 that shots gain from effects whose parameters were fitted to other shots.

    Windows and initial start states are those of the fit to the `whole`.
    """
    segments, starts = select_shot_windows(whole, recordings)
    if not segments:
        return 0.0
    before, after = fit_start_states(problem, segments, base, starts), fit_start_states(problem, segments, best, starts)
    return (before.cost - after.cost) / max(best.lack_of_fit, 1.0)


def refit_on_shots(
    problem: DiagnosisProblem, recordings: tuple[Recording, ...], like: EffectFit, options: ShootingOptions = FULL_FIT
) -> EffectFit:
    """Refit a hypothesis to some of its shots."""
    segments, starts = select_shot_windows(like, recordings)
    return refit_effects(problem, segments, like, starts, options=options)


def select_shot_windows(
    fitted: EffectFit, recordings: tuple[Recording, ...]
) -> tuple[tuple[Recording, ...], tuple[FloatArray, ...]]:
    """Select the windows of some shots of a fit, and their start states."""
    shots = {one.shot for one in recordings}
    here = [k for k, segment in enumerate(fitted.segments) if segment.shot in shots]
    return tuple(fitted.segments[k] for k in here), tuple(fitted.starts[k] for k in here)
