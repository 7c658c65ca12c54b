"""Size and correlation of the noise of recordings, estimated without a model of the motion.

Smooth motion is nearly a polynomial over a dozen frames; the residuals of a polynomial are noise. The share of noise of
a given autocorrelation that a polynomial absorbs is known exactly, so that size and correlation follow from the first
two lagged products of the residuals. Segments with a contact or an outlier have large residuals and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray

SEGMENT_FRAMES = 21
"""Frames of a segment."""
POLYNOMIAL_DEGREE = 5
"""Degree of the polynomial that is fitted to a segment."""
_MAX_SMOOTH_RATIO = 2.5
"""Largest sum of squared residuals of a smooth segment, relative to the median."""
_MAX_CORRELATION = 0.95
"""Largest correlation of neighbouring frames that such short segments can separate from smooth motion."""
_MOVING_SIGMAS = 20.0
"""Extent from which a body moves within a segment, standard deviations."""
_MOVING_NOISE_RATIO = 1.5
"""Ratio to the noise of all segments from which that of moving bodies is used: the errors of a body at rest repeat."""
_MIN_SEGMENTS = 8
"""Number of segments below which the stated sigmas are used."""
_SIDE_SAMPLES = 5
"""Samples on one side to which a parabola is fitted."""
_OUTLIER_SIGMAS = 6.0
"""Deviation from which a sample between consistent neighbours is an outlier, standard deviations."""
_MAX_OUTLIER_SHARE = 0.25
"""Share of the samples of a body from which they are no outliers: the noise is estimated too small, or the motion is
not smooth."""
_MIN_RELATIVE_SIGMA = 1e-7
"""Smallest standard deviation over the largest coordinate: ten times the error of the simulations themselves, which
would otherwise be the largest systematic residual of recordings without noise."""


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Noise of all recordings of one scene together."""

    scale: float
    """Noise relative to the stated sigmas."""
    correlation: float
    """Correlation of the errors of neighbouring frames; 0 where it is not significant."""
    segment_count: int
    """Number of smooth segments that the estimate is based on."""

    @property
    def is_measured(self) -> bool:
        """Whether there were enough smooth segments to measure it."""
        return self.segment_count >= _MIN_SEGMENTS


def estimate_noise(recordings: tuple[Recording, ...]) -> NoiseEstimate:
    """Estimate size and correlation of the noise of recordings.

    Args:
        recordings: Recordings of one scene, with stated sigmas.

    Returns:
        The estimate; scale 1 and correlation 0 where there are too few smooth segments.
    """
    residuals = [all_bodies for recording in recordings for all_bodies in _compute_polynomial_residuals(recording)]
    if not residuals:
        return NoiseEstimate(1.0, 0.0, 0)
    rows, moving = (np.concatenate([one[k] for one in residuals]) for k in range(2))
    all_bodies, moving_bodies = _estimate_from_residuals(rows), _estimate_from_residuals(rows[moving])
    return (
        moving_bodies
        if moving_bodies.segment_count >= _MIN_SEGMENTS and moving_bodies.scale > _MOVING_NOISE_RATIO * all_bodies.scale
        else all_bodies
    )


def _estimate_from_residuals(rows: FloatArray) -> NoiseEstimate:
    """Estimate the noise from polynomial residuals (M, SEGMENT_FRAMES)."""
    if not len(rows):
        return NoiseEstimate(1.0, 0.0, 0)
    size = np.square(rows).sum(axis=1)
    smooth = rows[size < _MAX_SMOOTH_RATIO * np.median(size)]
    if len(smooth) < _MIN_SEGMENTS:
        return NoiseEstimate(1.0, 0.0, len(smooth))
    correlation = _estimate_correlation(smooth)
    remaining, free = _compute_residual_products(correlation)[0], _degrees_of_freedom(correlation)
    # pieces beyond the limit are missing from the mean as much as chance puts there
    cut = _MAX_SMOOTH_RATIO * chi2.ppf(0.5, free)
    share = chi2.cdf(cut, free + 2) / chi2.cdf(cut, free)
    return NoiseEstimate(
        float(np.sqrt(np.square(smooth).sum(axis=1).mean() / share / remaining)), correlation, len(smooth)
    )


def _compute_polynomial_residuals(recording: Recording) -> list[tuple[FloatArray, BoolArray]]:
    """Compute polynomial residuals (M, SEGMENT_FRAMES) in stated sigmas for each body and coordinate.

    Segments are runs of SEGMENT_FRAMES consecutive frames. The mask (M,) marks segments in which the body moves.
    """
    residuals = []
    is_observed = recording.is_observed
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(is_observed[:, body])
        if len(rows) < SEGMENT_FRAMES:
            continue
        frames = np.lib.stride_tricks.sliding_window_view(recording.frame[rows], SEGMENT_FRAMES)
        even = np.flatnonzero(frames[:, -1] - frames[:, 0] == SEGMENT_FRAMES - 1)[:: SEGMENT_FRAMES // 2]
        # one sigma for a piece: a place over sigmas that differ from row to row is not smooth
        sigma = np.sqrt(
            np.lib.stride_tricks.sliding_window_view(recording.sigma[rows, body] ** 2, SEGMENT_FRAMES).mean(axis=1)
        )
        for values in recording.positions[rows, body].T:
            segments = np.lib.stride_tricks.sliding_window_view(values, SEGMENT_FRAMES)[even]
            residuals.append(
                (
                    segments @ _residual_projector() / sigma[even, None],
                    np.ptp(segments, axis=1) > _MOVING_SIGMAS * sigma[even],
                )
            )
    return residuals


@cache
def _residual_projector() -> FloatArray:
    """Return the matrix (SEGMENT_FRAMES, SEGMENT_FRAMES) that maps values to the residuals of a fitted polynomial."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, SEGMENT_FRAMES), POLYNOMIAL_DEGREE + 1))[0]
    return np.asarray(np.eye(SEGMENT_FRAMES) - basis @ basis.T)


def _compute_residual_products(correlation: float) -> tuple[float, float]:
    """Compute the expected sums of squares and of neighbour products of the residuals of unit noise."""
    left = _residual_covariance(correlation)
    return float(np.trace(left)), float(np.trace(left, offset=1))


def _residual_covariance(correlation: float) -> FloatArray:
    """Return the covariance (SEGMENT_FRAMES, SEGMENT_FRAMES) of polynomial residuals of unit noise."""
    lag = np.abs(np.subtract.outer(np.arange(SEGMENT_FRAMES), np.arange(SEGMENT_FRAMES)))
    return np.asarray(_residual_projector() @ correlation**lag @ _residual_projector())


def _degrees_of_freedom(correlation: float) -> float:
    """Return the degrees of freedom of a chi-square with the mean and variance of the squared residuals.

    Satterthwaite 1946, doi:10.2307/3002019.
    """
    left = _residual_covariance(correlation)
    return float(np.trace(left) ** 2 / np.trace(left @ left))


def _estimate_correlation(segments: FloatArray) -> float:
    """Estimate the correlation of noise from its residuals; 0 where it is not significant at 5 %."""
    products = (segments[:, 1:] * segments[:, :-1]).sum(axis=1)
    ratio = float(products.sum() / np.square(segments).sum())
    white = _compute_residual_products(0.0)
    # pieces overlap by half, so that about two of three are independent
    spread = float(np.std(products - white[1] / white[0] * np.square(segments).sum(axis=1)))
    error = spread / np.square(segments).sum(axis=1).mean() / np.sqrt(max(len(segments) / 1.5, 1.0))
    if ratio - white[1] / white[0] < 1.65 * error:
        return 0.0

    def beyond(correlation: float) -> float:
        squares, neighbours = _compute_residual_products(correlation)
        return neighbours / squares - ratio

    return float(brentq(beyond, 0.0, _MAX_CORRELATION)) if beyond(_MAX_CORRELATION) > 0 else _MAX_CORRELATION


def apply_noise_estimate(recordings: tuple[Recording, ...], noise: NoiseEstimate) -> tuple[Recording, ...]:
    """Scale the sigmas of recordings by a noise estimate and remove outliers.

    Args:
        recordings: Recordings with stated sigmas.
        noise: Estimate of their noise.

    Returns:
        Recordings with scaled sigmas, NaN in place of outliers.
    """
    scaled = (replace(one, sigma=np.maximum(one.sigma * noise.scale, _smallest_sigma(one))) for one in recordings)
    return tuple(
        replace(one, positions=np.where(_find_outliers(one)[:, :, None], np.nan, one.positions)) for one in scaled
    )


def _smallest_sigma(recording: Recording) -> float:
    """Return the standard deviation below which a simulation is no better than the recording."""
    return _MIN_RELATIVE_SIGMA * float(np.abs(recording.positions[recording.is_observed]).max(initial=0.0))


def _find_outliers(recording: Recording) -> BoolArray:
    """Return a mask (T, N) of samples far from the polynomials through their neighbours, on each side and on both."""
    bad = np.zeros(recording.is_observed.shape, bool)
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.is_observed[:, body])
        for k in range(len(rows)):
            supports = [
                _select_neighbours(rows, k, part) for part in ((-3, 4), (-_SIDE_SAMPLES, 0), (1, _SIDE_SAMPLES + 1))
            ]
            fits = [(near, order) for near, order in zip(supports, (3, 2, 2), strict=True) if near.size]
            apart = [recording.frame[near[-1]] - recording.frame[near[0]] <= 2 * _SIDE_SAMPLES for near, _ in fits]
            if len(fits) >= 2 and all(apart):
                bad[rows[k], body] = all(_is_off_polynomial(recording, body, int(rows[k]), *one) for one in fits)
        if bad[:, body].sum() > _MAX_OUTLIER_SHARE * len(rows):
            bad[:, body] = False
    return bad


def _select_neighbours(rows: IntArray, k: int, part: tuple[int, int]) -> IntArray:
    """Select the rows in a range around number k, without that one; empty where there are too few."""
    first, last = k + part[0], k + part[1]
    if first < 0 or last > len(rows):
        return np.empty(0, np.int64)
    return np.delete(rows[first:last], -part[0]) if part[0] <= 0 < part[1] else rows[first:last]


def _is_off_polynomial(recording: Recording, body: int, row: int, near: IntArray, order: int) -> bool:
    """Return whether a sample is far from a polynomial through other rows; at a kink it is so on one side at most."""
    span = recording.t[near[-1]] - recording.t[near[0]]
    weights = np.linalg.pinv(np.vander((recording.t[near] - recording.t[row]) / span, order + 1))[-1]
    off = np.abs(recording.positions[row, body] - weights @ recording.positions[near, body]).max()
    return bool(off > _OUTLIER_SIGMAS * recording.sigma[row, body] * np.sqrt(1 + weights @ weights))
