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
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2

from models.gap_scene import Recording

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SPAN = 21
"""pictures of a piece"""
DEGREE = 5
_CALM = 2.5
"""times the usual size of what a polynomial leaves, up to which a piece counts as smooth."""
_MOST = 0.95
"""largest correlation of neighbours that so short pieces can tell from smooth motion."""
_FEW = 8
"""pieces below which the stated sigmas are believed."""
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
    rows = np.concatenate(left)
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


def _left_over(recording: Recording) -> list[Floats]:
    """(pieces, SPAN) per body and coordinate, in stated sigmas, where SPAN pictures follow each other evenly."""
    found = []
    seen = recording.seen
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(seen[:, body])
        if len(rows) < SPAN:
            continue
        frames = np.lib.stride_tricks.sliding_window_view(recording.frame[rows], SPAN)
        even = np.flatnonzero(frames[:, -1] - frames[:, 0] == SPAN - 1)[:: SPAN // 2]
        for values in (recording.places[rows, body] / recording.sigma[rows, body, None]).T:
            pieces = np.lib.stride_tricks.sliding_window_view(values, SPAN)[even]
            found.append(pieces @ _projector())
    return found


@cache
def _projector() -> Floats:
    """(SPAN, SPAN) takes a polynomial out."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, SPAN), DEGREE + 1))[0]
    return np.eye(SPAN) - basis @ basis.T


def _expected(correlation: float) -> tuple[float, float]:
    """Sum of squares and of products of neighbours that a polynomial leaves of noise of size 1."""
    left = _remaining(correlation)
    return float(np.trace(left)), float(np.trace(left, offset=1))


def _remaining(correlation: float) -> Floats:
    """(SPAN, SPAN) covariance of what a polynomial leaves of noise of size 1."""
    lag = np.abs(np.subtract.outer(np.arange(SPAN), np.arange(SPAN)))
    return np.asarray(_projector() @ correlation**lag @ _projector())


def _degrees(correlation: float) -> float:
    """Degrees of freedom of the chi-square that has the mean and variance of what a polynomial leaves (Satterthwaite
    1946)."""
    left = _remaining(correlation)
    return float(np.trace(left) ** 2 / np.trace(left @ left))


def _correlation(pieces: Floats) -> float:
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


def _outliers(recording: Recording) -> Mask:
    """(T, N) samples far off a cubic through the six next to them, which agree with each other."""
    bad = np.zeros(recording.seen.shape, bool)
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.seen[:, body])
        for k, row in enumerate(rows):
            first = min(max(k - 3, 0), max(len(rows) - 7, 0))
            near = np.delete(rows[first : first + 7], k - first)
            near = near[~bad[near, body]]
            if len(near) == 6 and recording.frame[near[-1]] - recording.frame[near[0]] <= 9:
                bad[row, body] = _stands_out(recording, body, int(row), near)
    return bad


def _stands_out(recording: Recording, body: int, row: int, near: NDArray[np.int64]) -> bool:
    """Whether one sample is far off a cubic through its neighbours, and they are not."""
    span = recording.t[near[-1]] - recording.t[near[0]]
    design = np.vander((recording.t[near] - recording.t[row]) / span, 4)
    places, sigma = recording.places[near, body], recording.sigma[row, body]
    solved, inverse = np.linalg.lstsq(design, places, rcond=None)[0], np.linalg.inv(design.T @ design)
    off = np.abs(recording.places[row, body] - solved[-1]).max()
    rest = np.sqrt(np.square(places - design @ solved).sum() / (2 * places.shape[1]))
    return bool(off > _FAR * sigma * np.sqrt(1 + inverse[-1, -1]) and rest < 3 * sigma)
