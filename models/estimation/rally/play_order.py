"""Which sequences of hits, bounces and touches of the net can happen: the rules of a sport as a prior.

The state of play is a hidden Markov chain: who hit last, and what the object touched since. A rule is a field of
`Sport`. The half of an event may be doubtful, and so may be the state in which a clip begins; play that departs from
the rules is improbable, not impossible.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import ndtr

from models.core.court import BounceRule, Sport
from models.core.rally import RallyEventKind
from models.core.typing import BoolArray, FloatArray
from models.estimation.rally.event_chances import DEPARTURE

# States: before the service; then, for each player, a service that has yet to touch the own half, an object that comes,
# one that touched the net, and one that bounced on the other half; and the rally is over.
_BEFORE, _SERVED, _FLYING, _TOUCHED, _BOUNCED, _OVER = 0, 1, 2, 3, 4, 9
_STATES = 10
# Where an event is: in the half with smaller x, in the other, or on the floor beside a table.
_PLACES = 3


def start_play(sport: Sport) -> FloatArray:
    """Return the probabilities (10,) of the states in which a clip, or a part of it, may begin."""
    belief = np.ones(_STATES)
    belief[_OVER] = 0.0
    if not sport.serves_on_own_half:
        belief[[_SERVED, _SERVED + 4]] = 0.0
    return _normalize(belief)


def locate_event(x: FloatArray, sigma: FloatArray, is_off: BoolArray, sport: Sport) -> FloatArray:
    """Compute the probabilities (..., 3) that events are in either half, or on the floor beside a table.

    Args:
        x: (...) m along the court.
        sigma: (...) m.
        is_off: (...) whether it is on the floor beside a table.
    """
    far = ndtr((x - sport.length / 2) / np.maximum(sigma, 1e-6))
    return np.stack([np.where(is_off, 0.0, 1 - far), np.where(is_off, 0.0, far), np.where(is_off, 1.0, 0.0)], axis=-1)


def advance_play(belief: FloatArray, kind: RallyEventKind, where: FloatArray, sport: Sport) -> FloatArray:
    """Return the joint probabilities (..., 10) of the states after an event, and of the event.

    Args:
        belief: (..., 10) before it.
        kind: Of the event.
        where: (..., 3) of `locate_event`; the leading axes of both are broadcast.
    """
    matrices = _build_transitions(sport.bounce, sport.serves_on_own_half)["bounce" if kind == "landing" else kind]
    after = np.einsum("...s,hst->...ht", belief, matrices)
    return np.asarray((after * where[..., None]).sum(axis=-2))


def weigh_order(kinds: tuple[RallyEventKind | None, ...], where: FloatArray, is_new: BoolArray, sport: Sport) -> float:
    """Compute the natural logarithm of the probability of a sequence of events by the rules.

    Args:
        kinds: (F,) None for no event.
        where: (F, 3) of `locate_event`.
        is_new: (F,) whether the object was lost before the event, so that anything may have happened.
    """
    belief, total = start_play(sport), 0.0
    for kind, place, lost in zip(kinds, where, is_new, strict=True):
        belief = start_play(sport) if lost else belief
        if kind is not None:
            belief = advance_play(belief, kind, place, sport)
            total += float(np.log(belief.sum()))
            belief = belief / belief.sum()
    return total


def judge_order(kinds: tuple[RallyEventKind, ...], where: FloatArray, chances: FloatArray, sport: Sport) -> FloatArray:
    """Compute the probabilities (E,) that the rules leave to events: what does not fit in is of another kind, or none.

    Args:
        kinds: (E,)
        where: (E, 3) of `locate_event`.
        chances: (E,) probability of each, by itself.
    """
    count = len(kinds)
    maps = np.empty((count, 2, _STATES, _STATES))  # as stated, and otherwise
    contact: RallyEventKind = "bounce"
    for k, kind in enumerate(kinds):
        stated, other = (
            advance_play(np.eye(_STATES), name, where[k], sport) for name in (kind, contact if kind == "hit" else "hit")
        )
        maps[k, 0] = chances[k] * stated
        maps[k, 1] = (1 - chances[k]) / 2 * (np.eye(_STATES) + other)
    ahead, back = [start_play(sport)], [np.ones(_STATES)]
    for k in range(count):
        ahead.append(_normalize(ahead[-1] @ maps[k].sum(axis=0)))
        back.append(_normalize(maps[count - 1 - k].sum(axis=0) @ back[-1]))
    parts = np.array([ahead[k] @ maps[k] @ back[count - 1 - k] for k in range(count)]).reshape(count, 2)
    return np.asarray(parts[:, 0] / parts.sum(axis=1))


def _normalize(value: FloatArray) -> FloatArray:
    return np.asarray(value / value.sum())


@cache
def _build_transitions(rule: BounceRule, serves_on_own_half: bool) -> dict[RallyEventKind, FloatArray]:
    """Build the matrices (3, 10, 10), state to state, of each kind of event in either half, and on the floor."""
    hit, bounce, net = (np.zeros((_PLACES, _STATES, _STATES)) for _ in range(3))
    for one in (0, 1):
        own, other = 4 * one, 4 * (1 - one)
        hit[one, _BEFORE, own + (_SERVED if serves_on_own_half else _FLYING)] = 1
        for state in (_FLYING, _TOUCHED) if rule != "required" else ():
            hit[one, other + state, own + _FLYING] = 1
        if rule != "none":
            hit[one, other + _BOUNCED, own + _FLYING] = 1
        bounce[one, own + _SERVED, own + _FLYING] = 1
        bounce[one, own + _TOUCHED, _OVER] = 1
        for state in (_FLYING, _TOUCHED):
            bounce[one, other + state, other + _BOUNCED] = 1
        bounce[:, own + _BOUNCED, _OVER] = 1
        bounce[2, own + _SERVED : own + _BOUNCED, _OVER] = 1
        net[:, own + _SERVED : own + _BOUNCED, own + _TOUCHED] = 1
        net[:, own + _BOUNCED, _OVER] = 1
    bounce[:, _BEFORE, _BEFORE] = 1
    bounce[:, _OVER, _OVER] = net[:, _OVER, _OVER] = 1
    # what departs from the rules begins a new stroke, or ends the rally
    for one in (0, 1):
        hit[one, hit[one].sum(axis=1) == 0, 4 * one + _FLYING] = DEPARTURE
    hit[2] = (hit[0] + hit[1]) / 2
    for matrix in (bounce, net):
        for place in matrix:
            place[place.sum(axis=1) == 0, _OVER] = DEPARTURE
    return {"hit": hit, "bounce": bounce, "net": net}
