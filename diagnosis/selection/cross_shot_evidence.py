"""What other shots say of effects that some shots told: strengths found without them, and what they gain."""

from __future__ import annotations

from diagnosis.fitting.hypothesis_fits import GLANCE, USUAL, Fitted, Question, again, follow
from diagnosis.selection.effect_selection import adopted, lacking
from diagnosis.selection.hypotheses import Hypothesis, Search
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions


def confirmed(
    question: Question, state: Search, first: tuple[Recording, ...], second: tuple[Recording, ...]
) -> Hypothesis:
    """The hypothesis adopted, without those of several effects that `second` shots do not confirm, all strengths as
    the `first` ones tell them. Few shots, of which none could be spared, confirm what the others tell, one by one."""
    best, split = adopted(state), folds(first, second)
    while split and best.size > 1:
        gains = dict.fromkeys(sorted(best.names), 0.0)
        # what lacks an effect does not settle for long; cut short, it still knows the other shots: no gain for whole
        without = {name: lacking(state, best, name) for name in gains}
        for others, here in split:
            whole = alone(question, others, best.fitted)
            for name in gains:
                gains[name] += gain(question, best.fitted, here, alone(question, others, without[name], GLANCE), whole)
        least = min(gains, key=lambda name: gains[name])
        if gains[least] > 0:
            break
        best = state.tried[best.names - {least}]
    return best


def folds(
    first: tuple[Recording, ...], second: tuple[Recording, ...]
) -> list[tuple[tuple[Recording, ...], tuple[Recording, ...]]]:
    """Shots that tell strengths, and shots on which these are tried."""
    if second:
        return [(first, second)]
    numbers = sorted({one.shot for one in first})
    split = (
        (tuple(one for one in first if one.shot != n), tuple(one for one in first if one.shot == n)) for n in numbers
    )
    return [fold for fold in split if fold[0]]


def gain(question: Question, whole: Fitted, recordings: tuple[Recording, ...], base: Fitted, best: Fitted) -> float:
    """chi2 that shots gain from the effects, all parameters as other shots told them; their windows and where states
    are sought are those of the fit to the `whole`."""
    pieces, starts = of_shots(whole, recordings)
    if not pieces:
        return 0.0
    before, after = follow(question, pieces, base, starts), follow(question, pieces, best, starts)
    return (before.cost - after.cost) / max(best.lack, 1.0)


def alone(
    question: Question, recordings: tuple[Recording, ...], like: Fitted, options: ShootingOptions = USUAL
) -> Fitted:
    """A hypothesis as some of the shots tell it."""
    pieces, starts = of_shots(like, recordings)
    return again(question, pieces, like, starts, options=options)


def of_shots(fitted: Fitted, recordings: tuple[Recording, ...]) -> tuple[tuple[Recording, ...], tuple[FloatArray, ...]]:
    """Windows of some of the shots of a fit, and their starts."""
    shots = {one.shot for one in recordings}
    here = [k for k, piece in enumerate(fitted.pieces) if piece.shot in shots]
    return tuple(fitted.pieces[k] for k in here), tuple(fitted.starts[k] for k in here)
