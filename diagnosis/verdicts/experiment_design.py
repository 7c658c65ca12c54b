"""What to film next: of the shots already filmed, the kind that tells most of what an answer leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.fitting.fit_residuals import Residuals
from diagnosis.fitting.hypothesis_fits import Question, Told
from diagnosis.fitting.names import named, phase
from diagnosis.selection.signatures import signatures
from diagnosis.verdicts.localisation import excess
from models.core.typing import BoolArray, FloatArray

_MORE = (1, 2, 3, 5, 8, 12, 20, 30, 50)
"""further shots of one kind that are thought of."""


def film_next(question: Question, told: Told, found: Residuals, free: np.ndarray, group: tuple[str, ...]) -> str:
    """One sentence: which of the shots already filmed separates a group best, and how many more like it settle it."""
    if len(group) < 2:
        return ""
    one, other = question.mask(group[:1]), question.mask(group[1:2])
    whole = signatures(question, told, free | other)
    step = signatures(question, told, free).step(one)
    apart = [_separation(question, told, free | other, one, step, k) for k in range(len(told.shots))]
    best = int(np.argmax(apart))
    now = float(step @ whole.information[np.ix_(one, one)] @ step)
    missing = max(16.0 - now, 0.0)
    more = int(np.ceil(missing / apart[best])) if apart[best] > 0 else 0
    names = " from ".join(named(name) for name in group[:2])
    if apart[best] <= 0 or more > 50:
        return f"No shot like these tells {names}: film other speeds and directions, also at right angles to these."
    return f"To tell {names}, film {max(more, 1)} more like {_like(question, found, int(told.shots[best]))}."


def film_to_see(
    question: Question,
    told: Told,
    found: Residuals,
    free: BoolArray,
    usual: FloatArray,
    names: tuple[str, ...],
    lack: float,
) -> str:
    """One sentence for who has an answer: of the effects that these shots would miss at `usual` strength (P,), the one
    nearest to be seen, and how many more shots of which kind would show it; empty where none would be missed, or where
    no number of shots like these would show it."""
    missed = {name: _weakness(question, told, free, usual, name, lack) for name in names}
    missed = {name: times for name, times in missed.items() if times > 1}
    if not missed:
        return ""
    name = min(missed, key=lambda one: missed[one])
    for more in _MORE:
        left = [_weakness(question, _with_more(told, k, more), free, usual, name, lack) for k in range(len(told.shots))]
        if min(left) <= 1:
            like = _like(question, found, int(told.shots[int(np.argmin(left))]))
            return (
                f"This answer needs no more film. What these shots would not have shown is {named(name)} of usual"
                f" strength; {more} more like {like} would."
            )
    return ""


def film_what_is_left(question: Question, found: Residuals) -> str:
    """One sentence: where most of what no effect explains is, and what of it a second film would tell apart."""
    left = excess(found)
    sums = {
        (str(name), int(shot)): float(left[(found.phase == name) & (found.shot == shot)].sum())
        for name in np.unique(found.phase)
        for shot in np.unique(found.shot)
    }
    most, shot = max(sums, key=lambda one: sums[one])
    return (
        f"Most of what is left shows {phase(most)} in {_like(question, found, shot)}: film that shot again at half the"
        " speed, and once in another place; what stays with the place is the table or the camera."
    )


def _weakness(question: Question, told: Told, free: BoolArray, usual: FloatArray, name: str, lack: float) -> float:
    """How many times stronger than usual an effect would have to be to be seen, in its worst direction."""
    mask = question.mask((name,))
    seen_from = signatures(question, told, free & ~mask, lack).detectable(mask)
    return float(np.max(seen_from[mask] / usual[mask], initial=0.0))


def _with_more(told: Told, k: int, more: int) -> Told:
    """What would be told if shot number k had been played `more` times more."""
    times = 1.0 + more * (told.shots == told.shots[k])
    return replace(told, information=told.information * times[:, None, None])


def _separation(
    question: Question, told: Told, free: np.ndarray, one: np.ndarray, step: np.ndarray, shot: int
) -> float:
    """chi2 that a further shot like this one adds between the two."""
    more, now = signatures(question, _with_more(told, shot, 1), free), signatures(question, told, free)
    return float(step @ (more.information - now.information)[np.ix_(one, one)] @ step)


def _like(question: Question, found: Residuals, shot: int) -> str:
    """A shot by its number, how fast its fastest body is and where that goes then."""
    here = np.flatnonzero(found.shot == shot)
    top = here[int(np.argmax(found.speed[here]))]
    fastest, velocity = f"up to {float(found.speed[top]):.1f} {question.scene.unit}/s", found.velocity[top]
    if len(velocity) < 2 or question.scene.unit != "m":
        return f"shot {shot} ({fastest})"
    angle = np.degrees(np.arctan2(velocity[1], velocity[0]))
    return f"shot {shot} ({fastest}, there at {angle:.0f} degrees from x)"
