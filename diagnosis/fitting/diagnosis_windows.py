"""Windows as long as they may be: until a simulation forgets its start, or no longer comes near what was seen."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from diagnosis.fitting.hypothesis_fits import Fitted, Question, fit, model_of
from diagnosis.fitting.window_growth import grown, led
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import Eventful, Recording
from models.estimation.multiple_shooting.shooting_windows import sensitive_from

LEAST = 8
"""rows of a piece"""
FEWEST = 2
"""sightings of a body in a piece"""
SHORT = 0.5
"""s of a piece in which hardly anything happens"""
_EXPLAINS = 4.0
"""lack of fit up to which a fit is believed"""
_LOST = 30.0
"""standard deviations, in the middle of a window, from which the model has lost what was seen."""
_ROUNDS = 3


def stretches(question: Question, recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """What moves on its own, in pieces with enough rows."""
    whole = (piece for recording in recordings for piece in question.scene.stretches(recording))
    return tuple(piece for piece in whole if piece.seen.any(axis=1).sum() >= LEAST)


def fit_adaptively(
    question: Question,
    recordings: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
) -> Fitted:
    """Fit windows as long as the hypothesis allows; ValueError where nothing is long enough."""
    found = fit_begun(question, recordings, names, forms, guess)
    return grown(question, found) if isinstance(question.scene, Eventful) else found


def fit_begun(
    question: Question,
    recordings: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
) -> Fitted:
    """Fit windows that find their way from what is seen alone: short ones where much happens, else whole stretches,
    then pieces of those that turned out too long; ValueError where nothing is long enough."""
    pieces = stretches(question, recordings)
    if not pieces:
        raise ValueError(f"a diagnosis needs shots of at least {LEAST} pictures; there is none")
    if isinstance(question.scene, Eventful):
        return led(question, fit(question, _calm(pieces, question.scene.calm), names, forms, guess))
    found = _fit_whole(question, pieces, names, forms, guess)
    for _ in range(_ROUNDS):
        shorter = _shorter(question, found)
        if len(shorter) == len(found.pieces):
            break
        found = fit(question, shorter, names, forms, found.shared)
    return found


def lengthened(question: Question, recordings: tuple[Recording, ...], like: Fitted) -> Fitted:
    """A fit to these recordings, its windows as long as its own hypothesis allows."""
    if isinstance(question.scene, Eventful):
        return grown(question, like)
    return fit_adaptively(question, recordings, like.names, like.forms, like.shared)


def _calm(pieces: tuple[Recording, ...], span: float) -> tuple[Recording, ...]:
    """Pieces of about `span` seconds each."""
    return tuple(part for piece in pieces for part in _parts(piece, span))


def _fit_whole(
    question: Question,
    pieces: tuple[Recording, ...],
    names: tuple[str, ...],
    forms: tuple[str, ...] | None,
    guess: FloatArray | None,
) -> Fitted:
    """The better of two fits: from the guess, and, where that explains little, from what short pieces tell, in which
    hardly anything can happen in a wrong order."""
    found = fit(question, pieces, names, forms, guess)
    if found.lack < _EXPLAINS:
        return found
    short = _calm(pieces, SHORT)
    if len(short) == len(pieces):
        return found
    told = fit(question, short, names, forms, guess)
    return min((found, fit(question, pieces, names, forms, told.shared)), key=lambda one: one.cost)


def _parts(piece: Recording, span: float) -> list[Recording]:
    """Pieces of about `span` seconds each."""
    count = min(round(float(piece.t[-1] - piece.t[0]) / span), len(piece.t) // LEAST)
    ends = np.linspace(0, len(piece.t), max(count, 1) + 1).astype(int)
    parts = [piece.rows(int(first), int(last)) for first, last in pairwise(ends)]
    return parts if all(_can_be_followed(part) for part in parts) else [piece]


def _can_be_followed(piece: Recording) -> bool:
    """Whether every body is seen often enough to tell where it goes."""
    return bool((piece.seen.sum(axis=0) >= FEWEST).all())


def _shorter(question: Question, fitted: Fitted) -> tuple[Recording, ...]:
    """Pieces cut where they became too sensitive, and in the middle where the model lost them."""
    model = model_of(question, fitted.pieces, fitted.forms, np.zeros(len(question.priors), bool))
    found: list[Recording] = []
    for k, piece in enumerate(fitted.pieces):
        flow = model.flow(k, fitted.starts[k], fitted.shared)
        rows, bodies = np.nonzero(piece.seen)
        first = sensitive_from(flow.by_start * piece.sigma[rows, bodies][:, None, None])
        cut = int(rows[first]) if first < len(rows) else len(piece.t)
        if np.median(np.linalg.norm(flow.misfit, axis=1)) > _LOST:
            cut = min(cut, len(piece.t) // 2)
        found += _cut(piece, cut)
    return tuple(found)


def _cut(piece: Recording, row: int) -> list[Recording]:
    if row < LEAST or len(piece.t) - row < LEAST:
        return [piece]
    parts = [piece.rows(0, row), piece.rows(row, len(piece.t))]
    return parts if all(_can_be_followed(part) for part in parts) else [piece]
