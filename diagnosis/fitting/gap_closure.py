"""How far the gap shrinks: open-loop predictions of shots that chose nothing, before and after, and the noise floor.

A prediction starts from what the first pictures of a window tell of the state, and runs on without looking. The floor
is what the right model would reach from there: the noise of the measurement, and the error of the start as it grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.diagnosis_windows import LEAST, stretches
from diagnosis.fitting.hypothesis_fits import Fitted, Question, follow
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Eventful, Recording

START = 15
"""pictures that tell the state."""
HORIZON = 0.85
"""s of open-loop prediction."""
_SHORTEST = 6
"""pictures that a state can be told from, in shots too short for START."""
_BEYOND = 1.15
"""times the floor's squares, from which an error is more than the noise: how well the size of the noise is known, by
two standard deviations."""
_STARTS = 24
"""starts that are drawn to see what can be foreseen."""
_OPEN = 4.0
"""times what the better model leaves anyway, noise and all, that predictions may differ by because of their starts."""
_DRAWS = 2000
_GRANTED = 0.9
"""chance up to which a start may have been off by accident."""
_BETTER = 0.5
"""share of the variance of a start that a whole window must take away, for the rest to be the error of the start."""
_INTERVAL = (0.025, 0.975)


@dataclass(frozen=True, slots=True)
class Ahead:
    """A stretch to predict: its first `known` rows tell the state, the others are predicted."""

    piece: Recording
    known: int


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What can be predicted."""

    windows: tuple[Ahead, ...]
    starts: tuple[FloatArray, ...]
    """per window (S,)."""


@dataclass(frozen=True, slots=True)
class Predicted:
    """All windows of the held-out shots under one model."""

    starts: tuple[FloatArray, ...]
    """per window (S,), as its first rows tell them."""
    covariances: tuple[FloatArray, ...]
    """per window (S, S), of the starts."""
    paths: tuple[FloatArray, ...]
    """per window (T, N, D)."""
    squares: FloatArray
    """(W,) sum of squared errors over the predicted observations of a window."""


@dataclass(frozen=True, slots=True)
class Closing:
    """How much of the gap one model closes against another."""

    before: float
    """rms distance between predicted and seen."""
    after: float
    floor: float
    closed: float
    """(before^2 - after^2) / (before^2 - floor^2), clipped to [-1, 1]; NaN where it is not resolved."""
    interval: tuple[float, float]
    resolved: bool


def windows_ahead(question: Question, recordings: tuple[Recording, ...]) -> tuple[Ahead, ...]:
    """Windows of the held-out shots, half a window apart."""
    found = []
    for piece in stretches(question, recordings):
        known = min(_first_rows(question, piece), max(_SHORTEST, len(piece.t) // 3))
        first = 0
        while first + known + LEAST // 2 <= len(piece.t):
            end = int(np.searchsorted(piece.t, piece.t[first + known - 1] + HORIZON, side="right"))
            if first and end == len(piece.t) and end - first - known < known:
                break
            found.append(Ahead(piece.rows(first, end), known))
            first += max((end - first) // 2, known)
    seen = [one for one in found if one.piece.seen[: one.known].any(axis=0).all() and _moves(one.piece)]
    return tuple(one for one in seen if _begins_alike(question, one))


def _begins_alike(question: Question, one: Ahead) -> bool:
    """Whether a start that the first rows tell is one of the whole window too: a body may lie by them alone, and move
    by later ones."""
    pieces = (one.piece.rows(0, one.known), one.piece)
    told, whole = (question.scene.model((piece,), question.assumed_forms).windows[0].start for piece in pieces)
    return bool(told.shape == whole.shape)


def _first_rows(question: Question, piece: Recording) -> int:
    """How many pictures tell a state: half a second of them where much happens, for hidden spin shows slowly."""
    if not isinstance(question.scene, Eventful):
        return START
    return max(START, int(np.searchsorted(piece.t, piece.t[0] + question.scene.calm)))


def _moves(piece: Recording) -> bool:
    """Whether anything in it moves more than the noise."""
    return bool(_far(piece).sum() >= LEAST)


def _far(piece: Recording) -> BoolArray:
    """(T, N) where bodies are away from the middle of their places by more than the noise."""
    middle = np.nanmedian(piece.places, axis=0)
    return np.asarray((np.abs(piece.places - middle) > 5 * piece.sigma[:, :, None]).any(axis=2))


def foreseeable(question: Question, windows: tuple[Ahead, ...], like: Fitted, rng: np.random.Generator) -> Foreseen:
    """The windows without what even the better model could not foresee from their first rows, and where it starts.

    Where much happens, a contact makes metres of the micrometres that a start leaves open. Starts are drawn from what
    is known of them; a body is followed as long as they agree about it, and where it moves at all.
    """
    if not windows:
        return Foreseen((), ())
    states = _told(question, windows, like, None)
    if not isinstance(question.scene, Eventful):
        return Foreseen(windows, states.starts)
    found, starts, error = [], [], float(np.sqrt(like.lack))
    for one, start in zip(windows, states.starts, strict=True):
        # each by itself: what one window leaves unexplained says nothing of how well others are known
        own = _told(question, (one,), like, (start,))
        spread = _spread(question, one.piece, like, own, rng)
        lost = np.logical_or.accumulate(spread > _OPEN * error * np.median(one.piece.sigma), axis=0)
        lost |= _far(one.piece).sum(axis=0) < LEAST
        lost[: one.known] = False
        left = replace(one, piece=replace(one.piece, places=np.where(lost[..., None], np.nan, one.piece.places)))
        if left.piece.seen[left.known :].any():
            found.append(left)
            starts.append(own.starts[0])
    return Foreseen(tuple(found), tuple(starts))


def _told(
    question: Question, windows: tuple[Ahead, ...], like: Fitted, starts: tuple[FloatArray, ...] | None
) -> Fitted:
    """What the first rows of the windows tell of their states."""
    return follow(question, tuple(one.piece.rows(0, one.known) for one in windows), like, starts)


def _spread(question: Question, piece: Recording, like: Fitted, told: Fitted, rng: np.random.Generator) -> FloatArray:
    """(T, N) m by which predictions differ that begin as a fit of their first rows leaves their start open."""
    start, covariance = told.starts[0], told.shooting.start_covariances[0]
    middle = question.scene.predict(piece, start, like.shared, like.forms)
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    drawn = start + (rng.standard_normal((_STARTS, len(start))) * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    off = [question.scene.predict(piece, one, like.shared, like.forms) - middle for one in drawn]
    return np.asarray(np.sqrt(np.square(off).sum(axis=-1).mean(axis=0)))


def predict(
    question: Question, windows: tuple[Ahead, ...], like: Fitted, starts: tuple[FloatArray, ...] | None = None
) -> Predicted:
    """Predictions by the model and the parameters of a fit; states are sought from `starts` where given."""
    if not windows:
        return Predicted((), (), (), np.zeros(0))
    states = _told(question, windows, like, starts)
    paths = tuple(
        question.scene.predict(one.piece, start, like.shared, like.forms)
        for one, start in zip(windows, states.starts, strict=True)
    )
    squares = np.array([_squares(one, path - one.piece.places) for one, path in zip(windows, paths, strict=True)])
    return Predicted(states.starts, states.shooting.start_covariances, paths, squares)


def _squares(one: Ahead, miss: FloatArray) -> float:
    """Of misses (T, N, D) where something was predicted and seen."""
    later = one.piece.seen.copy()
    later[: one.known] = False
    return float(np.square(miss[later]).sum())


def floor(question: Question, windows: tuple[Ahead, ...], like: Fitted, found: Predicted) -> FloatArray:
    """(W,) squares that the right model would leave from the starts of the better one: noise, and how far the starts
    were off.

    How far a start was off is seen from the whole window, later than it was told; a wrong model mistakes its own error
    for that, so that no more is granted altogether than chance allows.
    """
    if not windows:
        return np.zeros(0)
    whole = follow(question, tuple(one.piece for one in windows), like, found.starts)
    off, surprise, free = np.zeros(len(windows)), 0.0, 0
    for k, one in enumerate(windows):
        path = question.scene.predict(one.piece, whole.starts[k], like.shared, like.forms)
        off[k] = _squares(one, found.paths[k] - path)
        one_surprise, one_free = surprise_of(
            whole.starts[k] - found.starts[k], found.covariances[k], whole.shooting.start_covariances[k]
        )
        surprise, free = surprise + one_surprise, free + one_free
    granted = min(1.0, float(chi2.ppf(_GRANTED, free)) / surprise) if surprise > 0 else 1.0
    coordinates = found.paths[0].shape[2]
    noise = [coordinates * float(np.square(w.piece.sigma[w.known :][w.piece.seen[w.known :]]).sum()) for w in windows]
    least = granted * off + np.array(noise)
    # the right model leaves no more than this one did
    return np.asarray(least * min(1.0, float(found.squares.sum()) / max(float(least.sum()), 1e-300)))


def surprise_of(step: FloatArray, told: FloatArray, better: FloatArray) -> tuple[float, int]:
    """chi2 of a step (S,) from a start of covariance `told` to one that is known `better`, and in how many directions.

    Only directions count that are known so much better that the step is the error of the first: elsewhere both hang on
    the same rows, and how far they may differ is a difference of two covariances that are themselves estimates.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(told), 1e-300))
    sizes, axes = np.linalg.eigh(told * scale * scale[:, None])
    kept = sizes > 1e-9 * sizes[-1]
    white = (axes[:, kept] / np.sqrt(sizes[kept])).T * scale
    gained, turn = np.linalg.eigh(white @ (told - better) @ white.T)
    known = gained > _BETTER
    return float((np.square(turn.T @ white @ step)[known] / gained[known]).sum()), int(known.sum())


def counts(windows: tuple[Ahead, ...]) -> FloatArray:
    """(W,) predicted observations of each window."""
    return np.array([one.piece.seen[one.known :].sum() for one in windows], dtype=np.float64)


def closing(
    windows: tuple[Ahead, ...],
    before: FloatArray,
    after: FloatArray,
    floor: FloatArray,
    rng: np.random.Generator,
    limit: float = 1.0,
) -> Closing:
    """From sums of squares (W,) of each window; the interval by drawing windows again, block by block.

    A share lies within -`limit` and `limit`: the part of one effect among several may be more than the whole.
    """
    count = counts(windows)
    if not count.sum():
        return Closing(float("nan"), float("nan"), float("nan"), float("nan"), (float("nan"), float("nan")), False)
    total = count.sum()
    b, a, f = (float(one.sum() / total) for one in (before, after, floor))
    drawn = _drawn(windows, rng)
    excess = drawn @ (before - floor)
    resolved = bool(np.quantile(drawn @ (before - _BEYOND * floor), _INTERVAL[0]) > 0)
    if not resolved:
        return Closing(*_roots(b, a, f), float("nan"), (-1.0, 1.0), False)
    closed = float(np.clip((b - a) / (b - f), -limit, limit))
    excess = excess + (drawn @ floor) * (_BEYOND - 1) / 2 * rng.standard_normal(len(drawn))
    ratios = np.clip(drawn @ (before - after) / np.maximum(excess, 1e-300), -limit, limit)
    low, high = np.quantile(ratios, _INTERVAL)
    interval = (min(float(low), closed), max(float(high), closed))
    return Closing(*_roots(b, a, f), closed, interval, True)


def _roots(*squares: float) -> tuple[float, float, float]:
    before, after, floor = (float(np.sqrt(max(one, 0.0))) for one in squares)
    return before, after, floor


def _drawn(windows: tuple[Ahead, ...], rng: np.random.Generator) -> FloatArray:
    """(draws, W) how often each window is drawn: shots where there are enough of them, else windows."""
    shots = np.array([one.piece.shot for one in windows])
    numbers = np.unique(shots)
    groups = (
        [np.flatnonzero(shots == n) for n in numbers]
        if len(numbers) >= 6
        else [np.array([k]) for k in range(len(shots))]
    )
    weight = rng.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), size=_DRAWS)
    found = np.zeros((_DRAWS, len(windows)))
    for group, drawn in zip(groups, weight.T, strict=True):
        found[:, group] = drawn[:, None]
    return found


def closed_ahead(
    question: Question, recordings: tuple[Recording, ...], base: Fitted, better: Fitted, rng: np.random.Generator
) -> Closing:
    """How much of the gap a better model closes on other recordings, their noise told."""
    foreseen = foreseeable(question, windows_ahead(question, recordings), better, rng)
    windows = foreseen.windows
    before, after = (predict(question, windows, one, foreseen.starts) for one in (base, better))
    return closing(windows, before.squares, after.squares, floor(question, windows, better, after), rng)


def shares(names: tuple[str, ...], squares_with: Callable[[frozenset[str]], FloatArray]) -> dict[str, FloatArray]:
    """(W,) per effect: its part of the squares that all of them take away, by Shapley's value (1953)."""
    parts = {}
    for name in names:
        others = [other for other in names if other != name]
        part: FloatArray = np.zeros(0)
        for size in range(len(names)):
            weight = factorial(size) * factorial(len(names) - size - 1) / factorial(len(names))
            for chosen in combinations(others, size):
                gained = squares_with(frozenset(chosen)) - squares_with(frozenset((*chosen, name)))
                part = weight * gained if part.size == 0 else part + weight * gained
        parts[name] = part
    return parts
