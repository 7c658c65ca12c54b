"""The fit of one shot, contact by contact: what was seen before a contact says how the balls come to it.

Over a whole shot the misfit has a minimum for every order of contacts that is nearly right. So the shot is fitted to
its first moments, then to a little more than the next contact that those moments foretell, and so on to its end. Where
what comes into view does not go on as what was seen before, side spin that no picture shows or a ball just missed are
the cause: then states are drawn from what the moments before leave open, and the best of them are followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.normal_equations import HUBER, glanced
from models.estimation.multiple_shooting.posterior_samples import drawn
from models.estimation.multiple_shooting.shooting_fit import UNDETERMINED, Shooting, ShootingOptions, shoot
from models.estimation.multiple_shooting.shooting_problem import Problem
from models.estimation.whole_shot.shot_windows import Shots
from models.physics.billiards.simulation.event_engine import TIME
from models.physics.billiards.simulation.parametrised_shot import SIDE_SPIN, sizes

Starts = tuple[FloatArray, ...]

FIRST = 0.25
"""s, the first moments: about a dozen pictures of every ball."""
BEYOND = 0.2
"""s after a contact that tell how it went."""
WHILE = 0.4
"""s over which the misfit of one ball is judged."""
LEAST, MOST = 0.1, 1.0
"""s by which the view grows at least, and at most: what was not foretold comes into view little by little too."""
_STEPS = ShootingOptions(iterations=12)
_PROMISED = 2.0
"""cost of an observation of two numbers whose noise is as promised."""
_CLEAR, _CLEARER = 3.0, 4.5
"""standard deviations of a sum of costs: of all, and of one of many."""
_NOISIEST = 2.0
"""over the variance promised: first moments that are explained no better are no measure."""
_FEW_STEPS = ShootingOptions(iterations=3)
_DRAWS = 192
"""which take as long as some ten steps of a search."""
_WIDER = 1.5
"""factor on the errors of what is drawn: errors of noise that is promised too small are too small."""
_ASIDE = 0.4
"""standard deviations of what was known beforehand."""
_LITTLE = 0.05
"""m/s of surface speed, below which side spin reversed is the same."""
_TRIED, _FOLLOWED = 12, 3
"""of the draws, those that cost least: begun, and of these followed."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Where a search stands."""

    starts: Starts
    shared: FloatArray


def grown(model: Shots, shared: FloatArray, rng: np.random.Generator, options: ShootingOptions) -> Shooting:
    """One shot fitted to more and more of what was seen of it, begun with the numbers `shared` (P,)."""
    now, _ = _followed(model, shared, rng, to_the_end=True)
    return _finished(model, now, options)


def grown_if_lawful(
    model: Shots, shared: FloatArray, rng: np.random.Generator, options: ShootingOptions
) -> Shooting | None:
    """The same, given up (None) where not even draws explain what comes into view: a wrong law shows at the first
    cushion, and following it to the end costs more than all that a right one does."""
    now, lawful = _followed(model, shared, rng, to_the_end=False)
    return _finished(model, now, options) if lawful else None


def _followed(model: Shots, shared: FloatArray, rng: np.random.Generator, to_the_end: bool) -> tuple[Guess, bool]:
    """Where a search stands once all was seen, and whether the laws explained it on the way: where not, the search goes
    on without draws, or ends."""
    begin, last = float(model.stretches[0].t[0]), max(float(stretch.t[-1]) for stretch in model.stretches)
    now, usual = _first(model, shared)
    seen, lawful = begin, True
    while seen < last:
        view = min(next_view(model, now, seen), last)
        part, before = model.until(view), now
        now = _begun(part, before)
        if not goes_on(part, now, usual):
            found = shoot(part, now.shared, _STEPS, now.starts)
            if lawful and not goes_on(part, _guess(found), usual):
                told = model.until(min(max(seen, begin + FIRST), view))
                found = _redrawn(told, part, before, found, rng)
                lawful = goes_on(part, _guess(found), usual)  # draws do not mend laws that are not those of the shot
            now = _guess(found)
            if not (lawful or to_the_end):
                break
        seen = view
    return now, lawful


def _finished(model: Shots, now: Guess, options: ShootingOptions) -> Shooting:
    """The fit to all that was seen of a shot, begun where a search stands."""
    found = shoot(model, now.shared, options, now.starts)
    tried = [shoot(model, one.shared, _FEW_STEPS, one.starts) for one in _opposites(model, found)]
    best = min([found, *tried], key=lambda one: one.cost)
    return found if best is found else shoot(model, best.shared, options, best.starts)


def _opposites(model: Shots, found: Shooting) -> list[Guess]:
    """Starts that a search does not find the way to: to either side in every number that the fit left as open as it
    was, for side spin so small that the cloth has spent it before a contact tells nothing; and side spin reversed."""
    guesses = []
    for k, (window, covariance) in enumerate(zip(model.windows, found.start_covariances, strict=True)):
        start, moved = found.starts[k], []
        for j in np.flatnonzero(np.sqrt(np.diag(covariance)) > UNDETERMINED * window.sigma):
            moved += [(j, start[j] + side * _ASIDE * window.sigma[j]) for side in (-1, 1)]
        spin = sizes(model.stretches[k].moving)[:-1][model.stretches[k].moving] + SIDE_SPIN
        moved += [(j, -start[j]) for j in spin if abs(start[j]) > _LITTLE]
        for j, value in moved:
            other = start.copy()
            other[j] = value
            guesses.append(Guess((*found.starts[:k], other, *found.starts[k + 1 :]), found.shared))
    return guesses


def next_view(model: Shots, now: Guess, seen: float) -> float:
    """Up to when (s) to look next: a little past the next contact that is foretold, or to the end of a stretch."""
    k = len(now.starts) - 1
    stretch = model.stretches[k]
    if seen >= stretch.t[-1]:
        return float(model.stretches[k + 1].t[0]) + FIRST
    run = model.possible_run(k, now.starts[k], now.shared)
    times = np.array([seen + LEAST]) if run is None else stretch.begin + run.contacts[:, TIME]
    after = times[times > seen]
    view = float(after[0]) + BEYOND if len(after) else float(stretch.t[-1])
    return min(max(view, seen + LEAST), seen + MOST, float(stretch.t[-1]))


def goes_on(model: Shots, now: Guess, usual: float) -> bool:
    """Whether all is explained as well as the first moments, at `usual` times the variance promised, and so is every
    ball at every time: a spin that is wrong shows for a while after a cushion."""
    costs = []
    for k, window in enumerate(model.windows):
        cost = _costs(model.glance(k, now.starts[k], now.shared).misfit)
        part = window.body + (int(window.body.max(initial=0)) + 1) * ((window.t - window.t[0]) / WHILE).astype(int)
        costs += [(cost, _CLEAR), *((cost[part == one], _CLEARER) for one in np.unique(part))]
    return all(one.sum() <= _PROMISED * usual * (len(one) + clear * np.sqrt(len(one))) for one, clear in costs)


def _first(model: Shots, shared: FloatArray) -> tuple[Guess, float]:
    """The best of all first guesses by the first moments, and their variance over what was promised, at least 1."""
    part = replace(model, stretches=(model.stretches[0].until(float(model.stretches[0].t[0]) + FIRST),))
    window = part.windows[0]
    tried = [shoot(part, shared, _FEW_STEPS, (start,)) for start in (window.start, *window.others)]
    begun = min(tried, key=lambda one: one.cost)
    best = shoot(part, begun.shared, _STEPS, begun.starts)
    most = 1 + _CLEAR / np.sqrt(max(len(window.t), 1))
    usual = 1.0 if np.isnan(best.chi2_per_dof) else float(np.clip(best.chi2_per_dof / most, 1.0, _NOISIEST))
    return _guess(best), usual


def _redrawn(before: Shots, part: Shots, now: Guess, found: Shooting, rng: np.random.Generator) -> Shooting:
    """The best fit of `part` from draws of what was left open by `before`, or the one found."""
    guesses = _others(before, part, now, rng)
    tried = sorted((shoot(part, one.shared, _FEW_STEPS, one.starts) for one in guesses), key=lambda one: one.cost)
    best = [shoot(part, one.shared, _STEPS, one.starts) for one in tried[:_FOLLOWED]]
    return min([found, *best], key=lambda one: one.cost)


def _others(before: Shots, part: Shots, now: Guess, rng: np.random.Generator) -> list[Guess]:
    """Draws from what `before` left open that explain `part` best, one of each order of contacts first."""
    told = Guess(now.starts[: len(before.windows)], now.shared)
    problem = Problem(part, part.windows, (tuple(range(len(part.windows))),))
    tried = []
    for starts, shared in drawn(before, told.starts, told.shared, _DRAWS, _WIDER, rng):
        guess = _begun(part, Guess(starts, shared))
        point = glanced(problem, guess.starts, guess.shared)
        tried.append((point.cost, tuple(flow.order for flow in point.flows), guess))
    tried.sort(key=lambda one: one[0])
    firsts = [k for k, one in enumerate(tried) if one[1] not in [other[1] for other in tried[:k]]]
    ranked = firsts[: _TRIED // 2] + [k for k in range(len(tried)) if k not in firsts[: _TRIED // 2]]
    return [tried[k][2] for k in ranked[:_TRIED] if np.isfinite(tried[k][0])]


def _begun(part: Shots, now: Guess) -> Guess:
    """With starts of the windows that have come into view; their spin is what the windows before hand over."""
    starts = list(now.starts)
    for k in range(len(starts), len(part.windows)):
        window, end = part.windows[k], part.glance(k - 1, starts[k - 1], now.shared).end
        tied = np.zeros(len(window.start), bool) if window.link is None else np.isfinite(window.link)
        starts.append(np.where(tied, end, window.start) if len(end) else window.start)
    return Guess(tuple(starts), now.shared)


def _guess(found: Shooting) -> Guess:
    return Guess(found.starts, found.shared)


def _costs(misfit: FloatArray) -> FloatArray:
    """(K,) robust cost of each observation."""
    size = np.linalg.norm(misfit, axis=1)
    inner = np.minimum(size, HUBER)
    return np.asarray(2 * size * inner - inner**2)
