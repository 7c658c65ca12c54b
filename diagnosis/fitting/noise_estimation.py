"""The noise of recordings and how long it lasts, from the recordings alone: no model of the motion is asked.

Whatever moves smoothly is nearly a polynomial over a dozen pictures. What a polynomial leaves is noise; how much of
noise with a given autocorrelation it would have swallowed is known exactly, so that size and correlation follow from
the first two lagged products of what it left. Pieces with a contact or an outlier stand out by their size and are left
out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import Recording

SPAN = 21
"""pictures of a piece"""
DEGREE = 5
_CALM = 2.5
"""times the usual size of what a polynomial leaves, up to which a piece counts as smooth."""
_MOST = 0.95
"""largest correlation of neighbours that so short pieces can tell from smooth motion."""
_WAY = 20.0
"""standard deviations that a body gets on in a piece, from which it moves."""
_UNLIKE = 1.5
"""times the noise of all pieces, from which that of moving bodies counts: a camera sees what lies ever the same way."""
_FEW = 8
"""pieces below which the stated sigmas are believed."""
_SIDE = 5
"""samples on one side that a parabola is put through."""
_FAR = 6.0
"""standard deviations from which one sample beside agreeing neighbours is an outlier."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Of all recordings of one scene together."""

    scale: float
    """the noise over the stated sigmas."""
    correlation: float
    """of the errors of neighbouring pictures; 0 where it is not significant."""
    pieces: int
    """how many smooth pieces it was estimated from."""


def estimate_noise(recordings: tuple[Recording, ...]) -> Noise:
    """Size and correlation of the noise; the stated sigmas where there are too few smooth pieces to tell."""
    left = [found for recording in recordings for found in _left_over(recording)]
    if not left:
        return Noise(1.0, 0.0, 0)
    rows, moving = (np.concatenate([one[k] for one in left]) for k in range(2))
    found, on_the_way = _of_pieces(rows), _of_pieces(rows[moving])
    return on_the_way if on_the_way.pieces >= _FEW and on_the_way.scale > _UNLIKE * found.scale else found


def _of_pieces(rows: FloatArray) -> Noise:
    """Of what polynomials left of pieces (M, SPAN)."""
    if not len(rows):
        return Noise(1.0, 0.0, 0)
    size = np.square(rows).sum(axis=1)
    calm = rows[size < _CALM * np.median(size)]
    if len(calm) < _FEW:
        return Noise(1.0, 0.0, len(calm))
    correlation = _correlation(calm)
    kept, free = _expected(correlation)[0], _degrees(correlation)
    # pieces beyond the limit are missing from the mean as much as chance puts there
    cut = _CALM * chi2.ppf(0.5, free)
    share = chi2.cdf(cut, free + 2) / chi2.cdf(cut, free)
    return Noise(float(np.sqrt(np.square(calm).sum(axis=1).mean() / share / kept)), correlation, len(calm))


def _left_over(recording: Recording) -> list[tuple[FloatArray, BoolArray]]:
    """(pieces, SPAN) per body and coordinate, in stated sigmas, where SPAN pictures follow each other evenly; and in
    which of them the body moves (pieces,)."""
    found = []
    seen = recording.seen
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(seen[:, body])
        if len(rows) < SPAN:
            continue
        frames = np.lib.stride_tricks.sliding_window_view(recording.frame[rows], SPAN)
        even = np.flatnonzero(frames[:, -1] - frames[:, 0] == SPAN - 1)[:: SPAN // 2]
        # one sigma for a piece: a place over sigmas that differ from row to row is not smooth
        sigma = np.sqrt(np.lib.stride_tricks.sliding_window_view(recording.sigma[rows, body] ** 2, SPAN).mean(axis=1))
        for values in recording.places[rows, body].T:
            pieces = np.lib.stride_tricks.sliding_window_view(values, SPAN)[even]
            found.append((pieces @ _projector() / sigma[even, None], np.ptp(pieces, axis=1) > _WAY * sigma[even]))
    return found


@cache
def _projector() -> FloatArray:
    """(SPAN, SPAN) takes a polynomial out."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, SPAN), DEGREE + 1))[0]
    return np.asarray(np.eye(SPAN) - basis @ basis.T)


def _expected(correlation: float) -> tuple[float, float]:
    """Sum of squares and of products of neighbours that a polynomial leaves of noise of size 1."""
    left = _remaining(correlation)
    return float(np.trace(left)), float(np.trace(left, offset=1))


def _remaining(correlation: float) -> FloatArray:
    """(SPAN, SPAN) covariance of what a polynomial leaves of noise of size 1."""
    lag = np.abs(np.subtract.outer(np.arange(SPAN), np.arange(SPAN)))
    return np.asarray(_projector() @ correlation**lag @ _projector())


def _degrees(correlation: float) -> float:
    """Degrees of freedom of the chi-square that has the mean and variance of what a polynomial leaves (Satterthwaite
    1946)."""
    left = _remaining(correlation)
    return float(np.trace(left) ** 2 / np.trace(left @ left))


def _correlation(pieces: FloatArray) -> float:
    """Of noise whose left-overs are the pieces; 0 where chance would show as much in one of twenty cases."""
    products = (pieces[:, 1:] * pieces[:, :-1]).sum(axis=1)
    ratio = float(products.sum() / np.square(pieces).sum())
    white = _expected(0.0)
    # pieces overlap by half, so that about two of three are independent
    spread = float(np.std(products - white[1] / white[0] * np.square(pieces).sum(axis=1)))
    error = spread / np.square(pieces).sum(axis=1).mean() / np.sqrt(max(len(pieces) / 1.5, 1.0))
    if ratio - white[1] / white[0] < 1.65 * error:
        return 0.0

    def beyond(correlation: float) -> float:
        squares, neighbours = _expected(correlation)
        return neighbours / squares - ratio

    return float(brentq(beyond, 0.0, _MOST)) if beyond(_MOST) > 0 else _MOST


def with_noise(recordings: tuple[Recording, ...], noise: Noise) -> tuple[Recording, ...]:
    """The recordings with sigmas as the noise was found, outliers taken out."""
    scaled = (replace(one, sigma=one.sigma * noise.scale) for one in recordings)
    return tuple(replace(one, places=np.where(_outliers(one)[:, :, None], np.nan, one.places)) for one in scaled)


def _outliers(recording: Recording) -> BoolArray:
    """(T, N) samples far off what their neighbours on either side say, and both sides together."""
    bad = np.zeros(recording.seen.shape, bool)
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.seen[:, body])
        for k in range(len(rows)):
            supports = [_near(rows, k, part) for part in ((-3, 4), (-_SIDE, 0), (1, _SIDE + 1))]
            known = [(near, order) for near, order in zip(supports, (3, 2, 2), strict=True) if near.size]
            apart = [recording.frame[near[-1]] - recording.frame[near[0]] <= 2 * _SIDE for near, _ in known]
            if len(known) >= 2 and all(apart):
                bad[rows[k], body] = all(_stands_out(recording, body, int(rows[k]), *one) for one in known)
    return bad


def _near(rows: IntArray, k: int, part: tuple[int, int]) -> IntArray:
    """The rows around number k that `part` says, itself left out; none where there are too few."""
    first, last = k + part[0], k + part[1]
    if first < 0 or last > len(rows):
        return np.empty(0, np.int64)
    return np.delete(rows[first:last], -part[0]) if part[0] <= 0 < part[1] else rows[first:last]


def _stands_out(recording: Recording, body: int, row: int, near: IntArray, order: int) -> bool:
    """Whether one sample is far off a polynomial through others; a bend in a path is so on one side at most."""
    span = recording.t[near[-1]] - recording.t[near[0]]
    design = np.vander((recording.t[near] - recording.t[row]) / span, order + 1)
    solved, inverse = (
        np.linalg.lstsq(design, recording.places[near, body], rcond=None)[0],
        np.linalg.inv(design.T @ design),
    )
    off = np.abs(recording.places[row, body] - solved[-1]).max()
    return bool(off > _FAR * recording.sigma[row, body] * np.sqrt(1 + inverse[-1, -1]))
