"""The fit of one shot, contact by contact: what was seen before a contact says how the balls come to it.

Over a whole shot the misfit has a minimum for every order of contacts that is nearly right. So the shot is fitted to
its first moments, then to a little more than the next contact that those moments foretell, and so on to its end. Where
what comes into view does not go on as what was seen before, side spin that no picture shows or a ball just missed are
the cause: then states are drawn from what the moments before leave open, and the best of them are followed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.attempt import HUBER, Problem, glanced
from models.billiards.engine import TIME
from models.billiards.shots import Shots
from models.draws import drawn
from models.shooting import Shooting, ShootingOptions, shoot

Floats = NDArray[np.float64]
Starts = tuple[Floats, ...]

FIRST = 0.25
"""s, the first moments: about a dozen pictures of every ball."""
BEYOND = 0.2
"""s after a contact that tell how it went."""
LEAST = 0.1
"""s by which the view grows at least."""
_STEPS = ShootingOptions(iterations=12)
_PROMISED = 2.0
"""cost of an observation of two numbers whose noise is as promised."""
_CLEAR = 4.0
"""standard deviations of a sum of costs."""
_DRAWS = 96
_WIDER = 1.5
"""factor on the errors of what is drawn: errors of noise that is promised too small are too small."""
_FOLLOWED = 4
"""of the draws, those that cost least."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Where a search stands."""

    starts: Starts
    shared: Floats


def grown(model: Shots, shared: Floats, rng: np.random.Generator, options: ShootingOptions) -> Shooting:
    """One shot fitted to more and more of what was seen of it, begun with the numbers `shared` (P,)."""
    seen, last = float(model.stretches[0].t[0]), max(float(stretch.t[-1]) for stretch in model.stretches)
    now = _first(model, shared)
    while seen < last:
        view = min(next_view(model, now, seen), last)
        now = _extended(model, now, seen, view, rng)
        seen = view
    return shoot(model, now.shared, options, now.starts)


def next_view(model: Shots, now: Guess, seen: float) -> float:
    """Up to when (s) to look next: a little past the next contact that is foretold, or to the end of a stretch."""
    k = len(now.starts) - 1
    stretch = model.stretches[k]
    if seen >= stretch.t[-1]:
        return float(model.stretches[k + 1].t[0]) + FIRST
    run = model.run(k, now.starts[k], now.shared)
    times = stretch.begin + run.contacts[:, TIME]
    after = times[times > seen]
    view = float(after[0]) + BEYOND if len(after) else float(stretch.t[-1])
    return min(max(view, seen + LEAST), float(stretch.t[-1]))


def goes_on(model: Shots, now: Guess, seen: float) -> bool:
    """Whether every ball's misfit after the time `seen` is as before, or as promised."""
    for k, window in enumerate(model.windows):
        cost = _costs(model.glance(k, now.starts[k], now.shared).misfit)
        late = window.t > seen
        usual = max(_PROMISED, float(cost[~late].mean()) if not late.all() else 0.0)
        for ball in np.unique(window.body[late]):
            own = cost[late & (window.body == ball)]
            if not own.sum() <= usual * (len(own) + _CLEAR * np.sqrt(len(own))):
                return False
    return True


def _first(model: Shots, shared: Floats) -> Guess:
    """The best of all first guesses, by the first moments."""
    part = model.until(float(model.stretches[0].t[0]) + FIRST)
    window = part.windows[0]
    tried = [shoot(part, shared, _STEPS, (start,)) for start in (window.start, *window.others)]
    return _guess(min(tried, key=lambda one: one.cost))


def _extended(model: Shots, now: Guess, seen: float, view: float, rng: np.random.Generator) -> Guess:
    """What is seen up to `view` taken in."""
    part = model.until(view)
    begun = _begun(part, now)
    found = shoot(part, begun.shared, _STEPS, begun.starts)
    if goes_on(part, _guess(found), seen):
        return _guess(found)
    others = [shoot(part, one.shared, _STEPS, one.starts) for one in _others(model, part, now, seen, rng)]
    return _guess(min([found, *others], key=lambda one: one.cost))


def _others(model: Shots, part: Shots, now: Guess, seen: float, rng: np.random.Generator) -> list[Guess]:
    """Draws from what was left open at `seen` that explain `part` best, one of each order of contacts first."""
    before = model.until(seen)
    told = Guess(now.starts[: len(before.windows)], now.shared)
    problem = Problem(part, part.windows, (tuple(range(len(part.windows))),))
    tried = []
    for starts, shared in drawn(before, told.starts, told.shared, _DRAWS, _WIDER, rng):
        guess = _begun(part, Guess(starts, shared))
        point = glanced(problem, guess.starts, guess.shared)
        tried.append((point.cost, tuple(flow.order for flow in point.flows), guess))
    tried.sort(key=lambda one: one[0])
    firsts = [k for k, one in enumerate(tried) if one[1] not in [other[1] for other in tried[:k]]]
    ranked = firsts + [k for k in range(len(tried)) if k not in firsts]
    return [tried[k][2] for k in ranked[:_FOLLOWED] if np.isfinite(tried[k][0])]


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


def _costs(misfit: Floats) -> Floats:
    """(K,) robust cost of each observation."""
    size = np.linalg.norm(misfit, axis=1)
    inner = np.minimum(size, HUBER)
    return np.asarray(2 * size * inner - inner**2)
