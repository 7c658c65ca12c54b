"""Windows joined with those that follow them, as long as their hypothesis explains what was seen.

A long window tells most of a weak effect, for what the effect does grows with time; but where much happens in little
time, a fit of long windows that is begun from nothing ends in a wrong order of events. Short windows find their way
from what is seen alone, and where a hypothesis explains two neighbours the first one's start is that of their union.
Where the union is not explained the hypothesis has come to its end, and the two stay as they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from diagnosis.fitting.hypothesis_fits import BETTER, Fitted, Question, again, follow, model_of
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.multiple_shooting.normal_equations import huber
from models.estimation.multiple_shooting.shooting_windows import glance, sensitive_from

One = TypeVar("One")

_NOWHERE, _UNLIKE = 25.0, 10.0
"""cost per number, and times that of the usual shot, from which a simulation comes nowhere near."""
_NEARLY_ALL = 0.25
"""share of shots from which it is no longer the shots that are odd."""
_ODD = 1.5
"""times the cost per number of noise, or of the usual shot, from which a shot is sought once more."""
_LITTLE_ODD = 1.1
"""the same, of a hypothesis that is weighed in earnest: twice what chance makes of a thousand numbers."""
_SURE = 1.3
"""the same, up to which a window may be so sensitive that a worse one would not find its way."""
_WORSE = 3.0
"""times the cost per number of noise, or of the windows that all began with, up to which a union is explained: a small
misfit is what a missing effect is known by, a large one follows a wrong path."""


def grown(question: Question, fitted: Fitted) -> Fitted:
    """The same hypothesis with windows as long as it explains; numbers that it holds fixed stay fixed."""
    fitted, ends = sought_anew(question, fitted), set[tuple[int, int]]()
    usual = max(float(np.divide(*_costs(question, fitted).sum(axis=0))), 1.0)
    while True:
        pairs = _pairs(question, fitted, ends)
        if not len(pairs):
            mean = np.divide(*_costs(question, fitted).sum(axis=0))
            return _sought_again(question, fitted) if mean < _SURE else fitted
        found = again(question, *_joined(fitted, pairs, fitted.starts))
        lost = _lost(question, found, pairs, usual)
        if lost.any():
            ends |= {_begin(fitted.pieces[k + 1]) for k in pairs[lost]}
            kept = pairs[~lost]
            starts = list(fitted.starts)
            for place, k in enumerate(pairs):
                starts[k] = starts[k] if lost[place] else found.starts[k - place]
            found = again(question, *_joined(fitted, kept, tuple(starts))) if len(kept) else fitted
        fitted = found


def led(question: Question, fitted: Fitted) -> Fitted:
    """The same hypothesis, windows that do not find their way from what is seen joined with the one before, which
    leads into them: one that is lost outweighs all that others tell."""
    costs = _costs(question, fitted)
    mean = costs[:, 0] / np.maximum(costs[:, 1], 1.0)
    lost = _nowhere_near(mean)
    follows = _pairs(question, fitted, {_begin(fitted.pieces[k]) for k in np.flatnonzero(~lost)})
    if not len(follows):
        return fitted
    found = again(question, *_joined(fitted, follows, fitted.starts))
    return found if found.cost < fitted.cost else fitted


def _begin(piece: Recording) -> tuple[int, int]:
    """Shot and first picture."""
    return piece.shot, int(piece.frame[0])


def _pairs(question: Question, fitted: Fitted, ends: set[tuple[int, int]]) -> np.ndarray:
    """Numbers of windows that are to be joined with the next one."""
    found: list[int] = []
    for k in range(len(fitted.pieces) - 1):
        one, other = fitted.pieces[k], fitted.pieces[k + 1]
        follows = one.shot == other.shot and one.bodies == other.bodies and other.t[0] > one.t[-1]
        if follows and _begin(other) not in ends and k - 1 not in found[-1:]:
            found.append(k)
    pairs = np.array(found, dtype=np.int64)
    windows = model_of(question, _joined(fitted, pairs, fitted.starts)[0], fitted.forms, fitted.free).windows
    alike = [windows[k - place].start.shape == fitted.starts[k].shape for place, k in enumerate(found)]
    return np.asarray(pairs[np.array(alike, dtype=bool)])


def _joined(
    fitted: Fitted, pairs: np.ndarray, starts: tuple[FloatArray, ...]
) -> tuple[tuple[Recording, ...], Fitted, tuple[FloatArray, ...]]:
    """The windows, some joined with the next one, with the starts of the first of each."""
    pieces, kept = [], []
    for k, piece in enumerate(fitted.pieces):
        if k - 1 in pairs:
            continue
        pieces.append(_union(piece, fitted.pieces[k + 1]) if k in pairs else piece)
        kept.append(starts[k])
    return tuple(pieces), fitted, tuple(kept)


def _union(one: Recording, other: Recording) -> Recording:
    return replace(
        one,
        frame=np.concatenate([one.frame, other.frame]),
        t=np.concatenate([one.t, other.t]),
        places=np.concatenate([one.places, other.places]),
        sigma=np.concatenate([one.sigma, other.sigma]),
    )


def _lost(question: Question, found: Fitted, pairs: np.ndarray, usual: float) -> BoolArray:
    """Which unions are not explained, at a usual cost per number, or forget their start."""
    costs, lost = _costs(question, found), []
    for place, k in enumerate(pairs):
        cost, numbers = costs[k - place]
        sure = cost <= _SURE * usual * numbers
        lost.append(not sure and (not cost <= _WORSE * usual * numbers or _forgets(question, found, k - place)))
    return np.array(lost, dtype=bool)


def sought_anew(question: Question, fitted: Fitted) -> Fitted:
    """Shots that are explained less well than others, begun once more from what was seen."""
    return _begun_beside(question, fitted, _odd(fitted, _per_number(question, fitted), _ODD))


def _begun_beside(question: Question, fitted: Fitted, bad: BoolArray) -> Fitted:
    """Bad windows begun once more from what was seen, under the numbers that the others tell: one on a wrong path bends
    what all share, until no other path explains it."""
    if not bad.any() or bad.all():
        return fitted
    kept, lost = np.flatnonzero(~bad), np.flatnonzero(bad)
    unbent = again(question, _of(fitted.pieces, kept), fitted, _of(fitted.starts, kept))
    fresh = follow(question, _of(fitted.pieces, lost), unbent, _of(fitted.starts, lost), anew=True)
    order = np.argsort(np.concatenate([kept, lost]))
    found = again(question, fitted.pieces, unbent, _of((*unbent.starts, *fresh.starts), order))
    return found if found.cost < fitted.cost else fitted


def straightened(question: Question, fitted: Fitted) -> Fitted:
    """The same hypothesis, odd shots sought anew for as long as that helps; only where it explains the others, for what
    is still missing makes shots odd too."""
    while _usual(mean := _per_number(question, fitted)) < _SURE:
        found = _begun_beside(question, fitted, _odd(fitted, mean, _LITTLE_ODD))
        if fitted.cost - found.cost < BETTER:
            return found
        fitted = found
    return fitted


def _odd(fitted: Fitted, mean: dict[int, float], factor: float) -> BoolArray:
    """Windows of shots whose cost per number is so many times that of the usual shot, or of noise."""
    odd = {shot for shot, cost in mean.items() if cost > factor * _usual(mean)}
    return np.array([piece.shot in odd for piece in fitted.pieces])


def _usual(mean: dict[int, float]) -> float:
    """Cost per number of the usual shot, or of noise."""
    return max(float(np.median(list(mean.values()))), 1.0)


def _per_number(question: Question, fitted: Fitted) -> dict[int, float]:
    """Cost per number of every shot."""
    costs, shots = _costs(question, fitted), np.array([piece.shot for piece in fitted.pieces])
    sums = {int(shot): costs[shots == shot].sum(axis=0) for shot in np.unique(shots)}
    return {shot: float(cost / max(numbers, 1.0)) for shot, (cost, numbers) in sums.items()}


def _of(all_of_them: tuple[One, ...], places: np.ndarray) -> tuple[One, ...]:
    return tuple(all_of_them[k] for k in places)


def _sought_again(question: Question, fitted: Fitted) -> Fitted:
    """All windows begun also from what was seen alone, numbers kept: hidden spin has several ways to be nearly right,
    and what one of them leaves would be taken for an effect."""
    return _with_the_better(question, fitted, np.arange(len(fitted.pieces)), fitted.starts, anew=True)


def begun_like(question: Question, fitted: Fitted, starts: tuple[FloatArray, ...]) -> Fitted:
    """The same hypothesis, shots that fit better from other starts (per window) begun from these."""
    return _with_the_better(question, fitted, np.arange(len(fitted.pieces)), starts, anew=False)


def not_followed(question: Question, fitted: Fitted) -> tuple[int, ...]:
    """Shots in which a simulation comes nowhere near what was seen, although it does in nearly all others: hands move
    balls, balls leave the table, films are cut."""
    mean = _per_number(question, fitted)
    lost = _nowhere_near(np.array(list(mean.values())))
    return tuple(shot for shot, far in zip(mean, lost, strict=True) if far) if lost.mean() < _NEARLY_ALL else ()


def _nowhere_near(mean: FloatArray) -> BoolArray:
    """Which costs per number are of simulations that come nowhere near what was seen, where others do."""
    return np.asarray((mean > _NOWHERE) & (mean > _UNLIKE * np.median(mean)))


def _with_the_better(
    question: Question, fitted: Fitted, places: np.ndarray, others: tuple[FloatArray, ...], anew: bool
) -> Fitted:
    """With the states that windows at `places` find from `others`, numbers kept, in shots that are better for it."""
    costs, shots = _costs(question, fitted), np.array([piece.shot for piece in fitted.pieces])
    chosen = tuple(fitted.pieces[k] for k in places)
    fresh = follow(question, chosen, fitted, tuple(others[k] for k in places), anew=anew)
    now, starts, better = _costs(question, fresh), list(fitted.starts), False
    for shot in np.unique(shots[places]):
        here = shots[places] == shot
        if now[here, 0].sum() < costs[places[here], 0].sum():
            better = True
            for k, start in zip(places[here], np.array(fresh.starts, dtype=object)[here], strict=True):
                starts[k] = np.asarray(start, dtype=np.float64)
    if not better:
        return fitted
    found = again(question, fitted.pieces, fitted, tuple(starts))
    return found if found.cost < fitted.cost else fitted


def _costs(question: Question, fitted: Fitted) -> FloatArray:
    """(W, 2) robust cost of every window, and how many numbers were seen in it."""
    model = model_of(question, fitted.pieces, fitted.forms, np.zeros(len(question.priors), bool))
    misfits = [glance(model, k, start, fitted.shared).misfit for k, start in enumerate(fitted.starts)]
    return np.array([(huber(one)[1], one.size) for one in misfits], dtype=np.float64)


def _forgets(question: Question, fitted: Fitted, window: int) -> bool:
    """Whether a window has become too sensitive to its start before its end."""
    piece = fitted.pieces[window]
    model = model_of(question, fitted.pieces, fitted.forms, np.zeros(len(question.priors), bool))
    rows, bodies = np.nonzero(piece.seen)
    by_start = model.flow(window, fitted.starts[window], fitted.shared).by_start
    return sensitive_from(by_start * piece.sigma[rows, bodies][:, None, None]) < len(by_start)
