"""Shots before any fit: their use, their length, and size and correlation of their noise.

The noise is estimated without a model of the motion. Smooth motion is nearly a polynomial over a dozen frames; the
residuals of a polynomial are noise. The share of noise of a given autocorrelation that a polynomial absorbs is known
exactly, so that size and correlation follow from the first two lagged products of the residuals. Segments with a
contact or an outlier have large residuals and are left out.

What a polynomial misses of a fast motion varies slowly, like correlated noise. It vanishes from shorter segments, and
noise does not: where segments with a single residual hold clearly less than the noise of longer ones would leave there,
the longer ones show motion, and the shortest ones the noise, though not its correlation.

The samples are placed at their times, and once more at their frame numbers; the estimate with less noise counts. A
clock that is wrong by dt adds speed times dt: the numbers of an unevenly sampled recording, and the times of an even
one where they are rounded to milliseconds.

Noise with a correlation rho from frame to frame is a first-order autoregression: the residual minus rho times the
previous one is white (Prais and Winsten 1954). Jacobians are transformed like residuals, so that a fit by least
squares stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import chi2

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    drop_shared_jacobian,
    predict_window,
    simulate_ahead,
)
from models.physics.effect import Prior

# Number of shots below which none is reserved for selection.
MIN_SHOTS_FOR_SELECTION = 6


@dataclass(frozen=True, slots=True)
class ShotSplit:
    """Recordings by their use; `holdout` must not be used before the verdict is final."""

    fitting: tuple[Recording, ...]
    """Shots that estimate parameters."""
    selection: tuple[Recording, ...]
    """Shots that confirm effects."""
    holdout: tuple[Recording, ...]
    """Shots on which the gap is reported."""


def split_shots(recordings: tuple[Recording, ...]) -> ShotSplit:
    """Split shots: half for fitting, a quarter for selection, a quarter for hold-out; few shots have no selection.

    Args:
        recordings: One recording per shot.

    Returns:
        The split.
    """
    ordered = tuple(sorted(recordings, key=lambda one: one.shot))
    if len(ordered) < MIN_SHOTS_FOR_SELECTION:
        fitting_count = len(ordered) if len(ordered) == 1 else len(ordered) - max(1, len(ordered) // 4)
        return ShotSplit(ordered[:fitting_count], (), ordered[fitting_count:])
    by_use: dict[str, list[Recording]] = {"fit": [], "select": [], "report": []}
    for place, one in enumerate(ordered):
        by_use[("fit", "select", "fit", "report")[place % 4]].append(one)
    return ShotSplit(*(tuple(by_use[use]) for use in ("fit", "select", "report")))


def find_common_duration(recordings: tuple[Recording, ...], total: float) -> float:
    """Find the duration to which recordings are shortened so that all together last no longer than `total`.

    Args:
        recordings: One recording per shot.
        total: s of all recordings together.

    Returns:
        s; infinite where nothing needs to be shortened.
    """
    durations = np.sort([one.t[-1] - one.t[0] for one in recordings])
    for k, duration in enumerate(durations):
        if duration * (len(durations) - k) >= total:
            return float(total / (len(durations) - k))
        total -= duration
    return float("inf")


def shorten_recordings(recordings: tuple[Recording, ...], duration: float) -> tuple[Recording, ...]:
    """Shorten recordings to their first `duration` s."""
    return tuple(one.select_rows(0, int(np.searchsorted(one.t, one.t[0] + duration, "right"))) for one in recordings)


# Frames of a segment.
SEGMENT_FRAMES = 21
# Degree of the polynomial that is fitted to a segment.
POLYNOMIAL_DEGREE = 5
# Largest step between samples of a segment, in smallest steps of the body, where frame numbers do not show that there
# is no gap: a missing frame of an even recording makes 2.
_MAX_STEP_RATIO = 1.9
# Number of segments whose times represent all: expected products of residuals are means over them, and change by less
# than 1 % between samples of this size.
_MAX_BASES = 200
# Largest sum of squared residuals of a smooth segment, relative to the median.
_MAX_SMOOTH_RATIO = 2.5
# Largest correlation of neighbouring frames that such short segments can separate from smooth motion.
_MAX_CORRELATION = 0.95
# Correlations for which expected products of residuals are tabulated; what lies between is interpolated to 0.005.
_CORRELATIONS = np.linspace(0.0, 0.97, 33)
# Least standard deviation of an estimated correlation of the noise, which is no exact autoregression.
_LEAST_CORRELATION_SIGMA = 0.06
# Extent from which a body moves within a segment, standard deviations.
_MOVING_SIGMAS = 20.0
# Frames of the shortest segments: their polynomials leave one residual.
_LEAST_FRAMES = POLYNOMIAL_DEGREE + 2
# Ratio to the noise of the shortest segments from which the residuals of longer ones are motion.
_MOTION_RATIO = 1.5
# Ratio to the noise of all segments from which that of moving bodies is used: the errors of a body at rest repeat.
_MOVING_NOISE_RATIO = 1.5
# Number of segments below which the stated sigmas are used.
_MIN_SEGMENTS = 8
# Samples on one side to which a parabola is fitted.
_SIDE_SAMPLES = 5
# Deviation from which a sample between consistent neighbours is an outlier, standard deviations.
_OUTLIER_SIGMAS = 6.0
# Share of the samples of a body from which they are no outliers: the noise is estimated too small, or the motion is not
# smooth.
_MAX_OUTLIER_SHARE = 0.25
# Smallest standard deviation over the largest coordinate: ten times the error of the simulations themselves, which
# would otherwise be the largest systematic residual of recordings without noise.
_MIN_RELATIVE_SIGMA = 1e-7


@dataclass(frozen=True, slots=True)
class CorrelationEstimate:
    """What the residuals of polynomials say of the correlation of noise, whose error is not normal near 1."""

    ratio: float
    """Sum of the products of neighbouring residuals over that of their squares."""
    sigma: float
    """Standard deviation of `ratio`."""
    correlations: FloatArray
    """(G,)"""
    ratios: FloatArray
    """(G,) expected `ratio` of these correlations, increasing."""

    @property
    def value(self) -> float:
        """The correlation."""
        return min(float(np.interp(self.ratio, self.ratios, self.correlations)), _MAX_CORRELATION)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw correlations (`count`,) within the error of the estimate."""
        low, estimated = np.interp([self.value - _LEAST_CORRELATION_SIGMA, self.value], self.correlations, self.ratios)
        drawn = self.ratio + max(self.sigma, float(estimated - low)) * rng.standard_normal(count)
        return np.interp(drawn, self.ratios, self.correlations)


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Noise of all recordings of one scene together."""

    scale: float
    """Noise relative to the stated sigmas."""
    correlation_estimate: CorrelationEstimate | None
    """Correlation of the errors of neighbouring frames; None where it is not significant."""
    segment_count: int
    """Number of smooth segments that the estimate is based on."""

    @property
    def correlation(self) -> float:
        """Correlation of the errors of neighbouring frames; 0 where it is not significant."""
        return 0.0 if self.correlation_estimate is None else self.correlation_estimate.value

    @property
    def is_measured(self) -> bool:
        """Whether there were enough smooth segments to measure it."""
        return self.segment_count >= _MIN_SEGMENTS


# White noise of the stated size.
WHITE_NOISE = NoiseEstimate(1.0, None, 0)


def estimate_noise(recordings: tuple[Recording, ...]) -> NoiseEstimate:
    """Estimate size and correlation of the noise of recordings.

    Args:
        recordings: Recordings of one scene, with stated sigmas.

    Returns:
        The estimate; scale 1 and correlation 0 where there are too few smooth segments.
    """
    estimates = [
        _estimate_at_times([(one, one.frame.astype(np.float64)) for one in recordings]),
        _estimate_at_times([(one, one.t) for one in recordings]),
    ]
    return min(estimates, key=lambda estimate: (not estimate.is_measured, estimate.scale))


def _estimate_at_times(recordings: Sequence[tuple[Recording, FloatArray]]) -> NoiseEstimate:
    """Estimate the noise of recordings whose samples are placed at times (T,)."""
    noise, short = (_estimate_in_segments(recordings, frames) for frames in (SEGMENT_FRAMES, _LEAST_FRAMES))
    if not (noise.is_measured and short.is_measured):
        return noise
    spread = np.arange(_LEAST_FRAMES, dtype=np.float64)[None]
    left = [_compute_residual_products(one, _build_polynomial_bases(spread))[0] for one in (noise.correlation, 0.0)]
    least = max(short.scale, _measure_rounding([one for one, _ in recordings]))
    if noise.scale * np.sqrt(left[0] / left[1]) <= _MOTION_RATIO * least:
        return noise
    return replace(short, scale=least)


def _measure_rounding(recordings: Sequence[Recording]) -> float:
    """Measure the error of coordinates that are told in steps, in stated sigmas; of several, the median."""
    errors = []
    for one in recordings:
        for body in range(len(one.bodies)):
            rows = np.flatnonzero(one.is_observed[:, body])
            steps = [np.diff(np.unique(values)) for values in one.positions[rows, body].T]
            sigma = float(np.median(one.sigma[rows, body])) if len(rows) else 1.0
            errors += [float(own.min()) / np.sqrt(12) / sigma for own in steps if len(own)]
    return float(np.median(errors)) if errors else 0.0


def _estimate_in_segments(recordings: Sequence[tuple[Recording, FloatArray]], frames: int) -> NoiseEstimate:
    """Estimate the noise from segments of as many frames."""
    parts = [part for recording, times in recordings for part in _compute_residuals(recording, times, frames)]
    if not parts:
        return WHITE_NOISE
    rows, moving, bases = (np.concatenate([part[k] for part in parts]) for k in range(3))
    all_bodies, moving_bodies = (
        _estimate_from_residuals(rows[chosen], bases[chosen]) for chosen in (np.full(len(rows), True), moving)
    )
    return (
        moving_bodies
        if moving_bodies.segment_count >= _MIN_SEGMENTS and moving_bodies.scale > _MOVING_NOISE_RATIO * all_bodies.scale
        else all_bodies
    )


def _estimate_from_residuals(rows: FloatArray, bases: FloatArray) -> NoiseEstimate:
    """Estimate the noise from residuals (M, F) of polynomials with bases (M, F, K)."""
    if not len(rows):
        return WHITE_NOISE
    size = np.square(rows).sum(axis=1)
    is_smooth = size < _MAX_SMOOTH_RATIO * np.median(size)
    smooth, bases = rows[is_smooth], bases[is_smooth]
    if len(smooth) < _MIN_SEGMENTS:
        return NoiseEstimate(1.0, None, len(smooth))
    bases = bases[:: -(-len(bases) // _MAX_BASES)]
    # one residual says nothing of a correlation
    estimate = _estimate_correlation(smooth, bases) if rows.shape[1] > _LEAST_FRAMES else None
    correlation = 0.0 if estimate is None else estimate.value
    remaining, free = _compute_residual_products(correlation, bases)[0], _degrees_of_freedom(correlation, bases)
    # pieces beyond the limit are missing from the mean as much as chance puts there
    cut = _MAX_SMOOTH_RATIO * chi2.ppf(0.5, free)
    share = chi2.cdf(cut, free + 2) / chi2.cdf(cut, free)
    scale = float(np.sqrt(np.square(smooth).sum(axis=1).mean() / share / remaining))
    return NoiseEstimate(scale, estimate, len(smooth))


def _compute_residuals(
    recording: Recording, times: FloatArray, count: int
) -> list[tuple[FloatArray, BoolArray, FloatArray]]:
    """Compute polynomial residuals (M, F) in stated sigmas for each body and coordinate.

    Segments are runs of F samples (`count`) without a gap. The mask (M,) marks segments in which the body moves; the
    bases (M, F, K) are those of the polynomials at the times of the samples.
    """
    residuals = []
    is_observed = recording.is_observed
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(is_observed[:, body])
        if len(rows) < count:
            continue
        frames, steps = sliding_window_view(recording.frame[rows], count), np.diff(times[rows])
        # the numbers of a body have gaps where another one was filmed in between
        is_whole = sliding_window_view(steps, count - 1).max(axis=1) < _MAX_STEP_RATIO * steps.min()
        is_whole |= frames[:, -1] - frames[:, 0] == count - 1
        chosen = np.flatnonzero(is_whole)[:: count // 2]
        bases = _build_polynomial_bases(sliding_window_view(times[rows], count)[chosen])
        # one sigma for a piece: a place over sigmas that differ from row to row is not smooth
        sigma = np.sqrt(sliding_window_view(recording.sigma[rows, body] ** 2, count)[chosen].mean(axis=1))
        for values in recording.positions[rows, body].T:
            segments = sliding_window_view(values, count)[chosen]
            absorbed = np.einsum("mik,mjk,mj->mi", bases, bases, segments, optimize=True)
            moving = np.ptp(segments, axis=1) > _MOVING_SIGMAS * sigma
            residuals.append(((segments - absorbed) / sigma[:, None], moving, bases))
    return residuals


def _build_polynomial_bases(times: FloatArray) -> FloatArray:
    """Build orthonormal bases (M, F, K) of the polynomials at times (M, F)."""
    span = times[:, -1:] - times[:, :1]
    scaled = 2 * (times - times[:, :1]) / span - 1
    return np.asarray(np.linalg.qr(scaled[:, :, None] ** np.arange(POLYNOMIAL_DEGREE + 1))[0])


def _compute_residual_products(correlation: float, bases: FloatArray) -> tuple[float, float]:
    """Compute the expected sums of squares and of neighbour products of the residuals of unit noise."""
    left = _residual_covariances(correlation, bases)
    traces = (np.trace(left, offset=offset, axis1=1, axis2=2).mean() for offset in (0, 1))
    return float(next(traces)), float(next(traces))


def _residual_covariances(correlation: float, bases: FloatArray) -> FloatArray:
    """Return the covariances (M, F, F) of polynomial residuals of unit noise."""
    frames = np.arange(bases.shape[1])
    lag = np.abs(np.subtract.outer(frames, frames))
    projectors = np.eye(len(frames)) - bases @ bases.transpose(0, 2, 1)
    return np.asarray(projectors @ correlation**lag @ projectors)


def _degrees_of_freedom(correlation: float, bases: FloatArray) -> float:
    """Return the degrees of freedom of a chi-square with the mean and variance of the squared residuals.

    Satterthwaite 1946, doi:10.2307/3002019.
    """
    left = _residual_covariances(correlation, bases)
    return float(np.trace(left, axis1=1, axis2=2).mean() ** 2 / np.square(left).sum(axis=(1, 2)).mean())


def _estimate_correlation(segments: FloatArray, bases: FloatArray) -> CorrelationEstimate | None:
    """Estimate the correlation of noise from its residuals; None where it is not significant at 5 %."""
    squares = np.square(segments).sum(axis=1)
    products = (segments[:, 1:] * segments[:, :-1]).sum(axis=1)
    ratio = float(products.sum() / squares.sum())
    white = _compute_residual_products(0.0, bases)
    # pieces overlap by half, so that about two of three are independent
    count = np.sqrt(max(len(segments) / 1.5, 1.0))

    def error(center: float) -> float:
        return float(np.std(products - center * squares) / squares.mean() / count)

    if ratio - white[1] / white[0] < 1.65 * error(white[1] / white[0]):
        return None
    left, neighbours = np.transpose([_compute_residual_products(one, bases) for one in _CORRELATIONS.tolist()])
    return CorrelationEstimate(ratio, error(ratio), _CORRELATIONS, np.maximum.accumulate(neighbours / left))


def apply_noise_estimate(recordings: tuple[Recording, ...], noise: NoiseEstimate) -> tuple[Recording, ...]:
    """Scale the sigmas of recordings by a noise estimate and remove outliers.

    Args:
        recordings: Recordings with stated sigmas.
        noise: Estimate of their noise.

    Returns:
        Recordings with scaled sigmas, NaN in place of outliers.
    """
    estimated = []
    for one in recordings:
        # below this a simulation is no better than the recording
        least = _MIN_RELATIVE_SIGMA * float(np.abs(one.positions[one.is_observed]).max(initial=0.0))
        one = replace(one, sigma=np.maximum(one.sigma * noise.scale, least))
        estimated.append(replace(one, positions=np.where(_find_outliers(one)[:, :, None], np.nan, one.positions)))
    return tuple(estimated)


def _find_outliers(recording: Recording) -> BoolArray:
    """Return a mask (T, N) of outliers: samples far from the polynomials through those before, after and around them.

    A good sample at a kink of the path still fits the polynomial of its own side.
    """
    bad = np.zeros(recording.is_observed.shape, bool)
    side = np.arange(1, _SIDE_SAMPLES + 1)
    for body in range(len(recording.bodies)):
        rows = np.flatnonzero(recording.is_observed[:, body])
        longest = (2 * _SIDE_SAMPLES + 0.5) * float(np.diff(recording.t[rows]).min(initial=np.inf))
        is_off, supports = np.ones(len(rows), bool), np.zeros(len(rows), np.int64)
        for offsets, order in ((np.array([-3, -2, -1, 1, 2, 3]), 3), (-side[::-1], 2), (side, 2)):
            inner = np.arange(max(-offsets[0], 0), len(rows) - max(offsets[-1], 0))
            supports[inner] += 1
            is_off[inner] &= _is_off_polynomial(
                recording, body, rows[inner], rows[inner[:, None] + offsets], order, longest
            )
        bad[rows, body] = is_off & (supports >= 2)
        if bad[:, body].sum() > _MAX_OUTLIER_SHARE * len(rows):
            bad[:, body] = False
    return bad


def _is_off_polynomial(
    recording: Recording, body: int, rows: IntArray, near: IntArray, order: int, longest: float
) -> BoolArray:
    """Return a mask (M,) of the samples `rows` that are far from the polynomial through K neighbours, `near` (M, K).

    Neighbours that span more than `longest` (s) and more than 2 `_SIDE_SAMPLES` frames say nothing of a sample.
    """
    frame, t = recording.frame[near], recording.t[near]
    span = t[:, -1] - t[:, 0]
    powers = ((t - recording.t[rows, None]) / span[:, None])[:, :, None] ** np.arange(order, -1, -1)
    weights = np.linalg.pinv(powers)[:, -1]
    off = np.abs(recording.positions[rows, body] - np.einsum("mk,mkd->md", weights, recording.positions[near, body]))
    limit = _OUTLIER_SIGMAS * recording.sigma[rows, body] * np.sqrt(1 + np.square(weights).sum(axis=1))
    is_near = (frame[:, -1] - frame[:, 0] <= 2 * _SIDE_SAMPLES) | (span <= longest)
    return np.asarray((off.max(axis=1) > limit) & is_near)


@dataclass(frozen=True, slots=True)
class NoiseChain:
    """Autoregression of the noise of a window with K observations: the previous observation of each body."""

    previous: IntArray
    """(K,) index of the previous observation of the same body; the own index where there is none."""
    correlation: FloatArray
    """(K,) correlation with the previous observation, 0 where there is none."""

    def whiten(self, values: FloatArray) -> FloatArray:
        """Whiten values (K, ...) whose errors have unit variance."""
        scale = 1 / np.sqrt(1 - self.correlation**2)
        return np.asarray(((values.T - self.correlation * values[self.previous].T) * scale).T)


def build_noise_chain(segment: Recording, correlation: float) -> NoiseChain:
    """Build the chain of the observations of a segment, in the order of its rows."""
    rows, bodies = np.nonzero(segment.is_observed)
    before, correlations = np.arange(len(rows)), np.zeros(len(rows))
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        before[own[1:]] = own[:-1]
        correlations[own[1:]] = correlation ** np.diff(segment.frame[rows[own]])
    return NoiseChain(before, correlations)


@dataclass(frozen=True, slots=True)
class WhitenedModel:
    """A model with whitened residuals, by one chain per window."""

    model: ShootingModel
    chains: tuple[NoiseChain, ...]

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the shared parameters."""
        return self.model.unknowns

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the model."""
        return self.model.windows

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Linearise a window and whiten its residuals and Jacobians."""
        return self._whiten_window(window, self.model.linearize(window, start, shared))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow | LinearizedWindow:
        """Simulate a window and whiten its residuals."""
        simulated = predict_window(self.model, window, start, shared)
        if isinstance(simulated, LinearizedWindow):
            return self._whiten_window(window, simulated)
        return replace(simulated, residual=self.chains[window].whiten(simulated.residual))

    @property
    def simulates_together(self) -> bool:
        """Whether the model simulates windows together."""
        return bool(getattr(self.model, "simulates_together", False))

    def simulate_ahead(
        self, windows: Sequence[int], starts: Sequence[FloatArray], shared: Sequence[FloatArray], has_jacobians: bool
    ) -> WhitenedModel:
        """Let the model simulate windows together where it can."""
        return replace(self, model=simulate_ahead(self.model, windows, starts, shared, has_jacobians))

    def without_shared_jacobian(self) -> WhitenedModel:
        """Return the model without derivatives by the shared parameters."""
        return replace(self, model=drop_shared_jacobian(self.model))

    def _whiten_window(self, window: int, flow: LinearizedWindow) -> LinearizedWindow:
        """Whiten residuals and Jacobians of a linearised window."""
        own = self.chains[window]
        return replace(
            flow,
            residual=own.whiten(flow.residual),
            start_jacobian=own.whiten(flow.start_jacobian),
            shared_jacobian=own.whiten(flow.shared_jacobian),
        )
