"""What to film next: the kind of shot that tells most of what is still open, of those seen and their variations."""

from __future__ import annotations

import numpy as np

from diagnosis.fitting import Question, Told
from diagnosis.residuals import Residuals
from diagnosis.signatures import signatures


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
    shot = int(told.shots[best])
    what = _described(found, shot)
    names = " from ".join(group[:2])
    if apart[best] <= 0 or more > 50:
        return f"No shot like these tells {names}: film other speeds and directions, also at right angles to these."
    return f"To tell {names}, film {max(more, 1)} more like shot {shot} ({what})."


def _separation(
    question: Question, told: Told, free: np.ndarray, one: np.ndarray, step: np.ndarray, shot: int
) -> float:
    """chi2 that a further shot like this one adds between the two."""
    again = Told(told.shots, told.information * (1 + (told.shots == told.shots[shot]))[:, None, None], told.score)
    more, now = signatures(question, again, free), signatures(question, told, free)
    return float(step @ (more.information - now.information)[np.ix_(one, one)] @ step)


def _described(found: Residuals, shot: int) -> str:
    here = found.shot == shot
    speed = float(np.quantile(found.speed[here], 0.9))
    first = found.velocity[here][0]
    if len(first) < 2:
        return f"up to {speed:.1f} per second"
    angle = np.degrees(np.arctan2(first[1], first[0]))
    return f"up to {speed:.1f} m/s, {angle:.0f} degrees from x"
